"""The network of drivers that were trained here: two layers over MetaDrive's observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from torch import nn

from sada_gym.agents.shipped_policy import ShippedPolicy
from sada_gym.envs.metadrive.episodes import OBSERVATION_SPACE
from sada_gym.envs.metadrive.task import DriveTaskEnv

LAYERS = (256, 256)
_LOG_NOISE = -0.7
"""The logarithm of the noise on actions with which PPO begins: 0.5."""


class DriverPolicy(ShippedPolicy):
    """Two layers, and two more for the value."""

    architecture: ClassVar[str] = "sada_gym metadrive"
    environment = DriveTaskEnv
    settings: ClassVar[Mapping[str, Any]] = {
        "net_arch": [*LAYERS],
        "activation_fn": nn.Tanh,
        "log_std_init": _LOG_NOISE,
    }
    kind, trained_by, seen = "driver", "studies.training.metadrive.train", OBSERVATION_SPACE
    built: ClassVar[Mapping[str, Any]] = {"layers": list(LAYERS)}


new_model, save, load = DriverPolicy.new_model, DriverPolicy.save_model, DriverPolicy.load_model
