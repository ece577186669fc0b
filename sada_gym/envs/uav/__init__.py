"""UAV racing: tracks, gates, the drone, the camera, the rules and their scoring.

Names are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sada_gym.envs.uav.application import UAVApplication
    from sada_gym.envs.uav.env import UAVEnv, UAVVectorEnv
    from sada_gym.envs.uav.task import RacingTaskEnv, RacingTaskVectorEnv

__all__ = [
    "RacingTaskEnv",
    "RacingTaskVectorEnv",
    "UAVApplication",
    "UAVEnv",
    "UAVVectorEnv",
]

_MODULES = {
    "RacingTaskEnv": "task",
    "RacingTaskVectorEnv": "task",
    "UAVApplication": "application",
    "UAVEnv": "env",
    "UAVVectorEnv": "env",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        from importlib import import_module

        return getattr(import_module(f"sada_gym.envs.uav.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
