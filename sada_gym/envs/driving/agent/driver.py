"""Drivers: models and other agents that choose the actions of cars."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.agents.policy import as_policy
from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.driving.episodes import DrivingEpisodes

Driver = Agent[DrivingEpisodes, npt.NDArray[np.float64]]
"""Chooses the actions of cars."""

DriverLike = Predictor | Driver
"""What can drive: an SB3 model of the driving task, or an agent as it is."""


def as_driver(agent: Any) -> Driver:
    """Give the driver that an agent means.

    Raises:
        UserError: If it is no `DriverLike`, or a model's spaces are not the driving task's.
    """
    return as_policy(agent, DrivingEpisodes)
