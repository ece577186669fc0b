"""The robots' network: two layers over the lidar's sectors and the state; robots in files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from torch import nn

from sada_gym.agents.shipped_policy import PolicyFiles, ShippedPolicy
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


new_model = RobotPolicy.new_model
FILES = PolicyFiles(
    kind="robot",
    trained_by="studies.training.robot.train",
    new_model=new_model,
    observation_space=OBSERVATION_SPACE,
    built={"layers": list(LAYERS)},
)
save, load = FILES.save, FILES.load
