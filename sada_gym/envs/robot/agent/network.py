"""The robots' network: two layers over the lidar's sectors and the state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from stable_baselines3 import PPO
from stable_baselines3.common.type_aliases import GymEnv
from torch import nn

from sada_gym.agents.shipped_policy import ShippedPolicy, new_ppo
from sada_gym.envs.robot.task import RobotTaskEnv

LAYERS = (128, 128)
_LOG_NOISE = -0.7
"""The logarithm of the noise on actions with which PPO begins: 0.5."""


class RobotPolicy(ShippedPolicy):
    """Two layers, and two more for the value."""

    architecture: ClassVar[str] = "sada_gym robot"
    settings: ClassVar[Mapping[str, Any]] = {
        "net_arch": [*LAYERS],
        "activation_fn": nn.Tanh,
        "log_std_init": _LOG_NOISE,
    }


def new_model(seed: int, env: GymEnv | None = None, **options: Any) -> PPO:
    """Make an untrained robot: a PPO with this network.

    Args:
        seed: The number that fixes the weights.
        env: What it will be trained on; by default one task.
        **options: Further options of PPO.
    """
    return new_ppo(RobotPolicy, env or RobotTaskEnv(), seed, **options)
