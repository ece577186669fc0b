"""What can steer a robot: a model of the robot's task, or an agent as it is."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent, as_agent
from sada_gym.agents.policy import Policy
from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.robot.episodes import Trips

RobotDriver = Agent[Trips, npt.NDArray[np.float64]]
"""Chooses the actions of robots."""

RobotDriverLike = Predictor | RobotDriver
"""What can steer a robot: an SB3 model of the robot's task, or an agent as it is."""


def as_driver(agent: Any) -> RobotDriver:
    """Give the driver that an agent means.

    Raises:
        UserError: If it is no `RobotDriverLike`, or a model's spaces are not the robot task's.
    """
    return as_agent(
        agent, partial(Policy, episodes=Trips), f"an SB3 model trained on {Trips.task_id}"
    )
