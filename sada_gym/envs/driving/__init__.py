"""Self-driving: the town, the camera, the vehicle, the tasks and their scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.driving.application import DrivingApplication
    from sada_gym.envs.driving.episodes import DriveDistribution
    from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv

__all__ = ["DriveDistribution", "DrivingApplication", "DrivingTaskEnv", "DrivingTaskVectorEnv"]

__getattr__ = lazy_names(
    __name__,
    {
        "DriveDistribution": "episodes",
        "DrivingApplication": "application",
        "DrivingTaskEnv": "task",
        "DrivingTaskVectorEnv": "task",
    },
)
