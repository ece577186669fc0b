"""Self-driving: the town, the camera, the vehicle, the tasks and their scoring.

Names are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sada_gym.envs.driving.application import DrivingApplication
    from sada_gym.envs.driving.course import Course
    from sada_gym.envs.driving.env import DrivingEnv, DrivingVectorEnv
    from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv

__all__ = [
    "Course",
    "DrivingApplication",
    "DrivingEnv",
    "DrivingTaskEnv",
    "DrivingTaskVectorEnv",
    "DrivingVectorEnv",
]

_MODULES = {
    "Course": "course",
    "DrivingApplication": "application",
    "DrivingEnv": "env",
    "DrivingTaskEnv": "task",
    "DrivingTaskVectorEnv": "task",
    "DrivingVectorEnv": "env",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        from importlib import import_module

        return getattr(import_module(f"sada_gym.envs.driving.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
