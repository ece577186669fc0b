"""The robot: the warehouse, the lidar, the physics, the task and its scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.robot.application import RobotApplication
    from sada_gym.envs.robot.conditions import Conditions
    from sada_gym.envs.robot.start import TripDistribution
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
        "Conditions": "conditions",
        "TripDistribution": "start",
        "RobotApplication": "application",
        "RobotTaskEnv": "task",
        "RobotTaskVectorEnv": "task",
    },
)
