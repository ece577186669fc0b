"""The robots' network: two layers over the lidar's sectors and the state; robots in files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from torch import nn

from sada_gym.agents.shipped_policy import ShippedPolicy
from sada_gym.envs.robot.episodes import OBSERVATION_SPACE
from sada_gym.envs.robot.task import RobotTaskEnv

LAYERS = (128, 128)
_LOG_NOISE = -0.7
"""The logarithm of the noise on actions with which PPO begins: 0.5."""


class RobotPolicy(ShippedPolicy):
    """Two layers, and two more for the value."""

    architecture: ClassVar[str] = "sada_gym robot"
    environment = RobotTaskEnv
    settings: ClassVar[Mapping[str, Any]] = {
        "net_arch": [*LAYERS],
        "activation_fn": nn.Tanh,
        "log_std_init": _LOG_NOISE,
    }
    kind, trained_by, seen = "robot", "studies.training.robot.train", OBSERVATION_SPACE
    built: ClassVar[Mapping[str, Any]] = {"layers": list(LAYERS)}


new_model, save, load = RobotPolicy.new_model, RobotPolicy.save_model, RobotPolicy.load_model
