"""The robots' network: two layers over the lidar's sectors and the state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from torch import nn

from sada_gym.agents.shipped_policy import ShippedPolicy
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


new_model = RobotPolicy.new_model
