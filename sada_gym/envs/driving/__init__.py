"""Self-driving: the town, the camera, the vehicle, the tasks and their scoring."""

from typing import TYPE_CHECKING

from sada_gym.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.driving.application import DrivingApplication
    from sada_gym.envs.driving.course import Course
    from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv

__all__ = ["Course", "DrivingApplication", "DrivingTaskEnv", "DrivingTaskVectorEnv"]

__getattr__ = lazy_names(
    __name__,
    {
        "Course": "course",
        "DrivingApplication": "application",
        "DrivingTaskEnv": "task",
        "DrivingTaskVectorEnv": "task",
    },
)
