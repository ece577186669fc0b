"""The robot: the warehouse, the lidar, the physics, the task and its scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.robot.application import RobotApplication
    from sada_gym.envs.robot.start import Conditions, TripDistribution
    from sada_gym.envs.robot.task import RobotTaskEnv, RobotTaskVectorEnv

__all__ = [
    "Conditions",
    "RobotApplication",
    "RobotTaskEnv",
    "RobotTaskVectorEnv",
    "TripDistribution",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Conditions": "start",
        "TripDistribution": "start",
        "RobotApplication": "application",
        "RobotTaskEnv": "task",
        "RobotTaskVectorEnv": "task",
    },
)
