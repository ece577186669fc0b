"""Self-driving: the town, the camera, the vehicle, the tasks and their scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.driving.application import DrivingApplication
    from sada_gym.envs.driving.start_distribution import StartDistribution
    from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv

__all__ = ["DrivingApplication", "DrivingTaskEnv", "DrivingTaskVectorEnv", "StartDistribution"]

__getattr__ = lazy_names(
    __name__,
    {
        "StartDistribution": "start_distribution",
        "DrivingApplication": "application",
        "DrivingTaskEnv": "task",
        "DrivingTaskVectorEnv": "task",
    },
)
