"""UAV racing: tracks, gates, the drone, the camera, the rules and their scoring."""

from typing import TYPE_CHECKING

from sada_gym.foundations.lazy import lazy_names

if TYPE_CHECKING:
    from sada_gym.envs.uav.application import UAVApplication
    from sada_gym.envs.uav.task import RacingTaskEnv, RacingTaskVectorEnv

__all__ = ["RacingTaskEnv", "RacingTaskVectorEnv", "UAVApplication"]

__getattr__ = lazy_names(
    __name__,
    {"RacingTaskEnv": "task", "RacingTaskVectorEnv": "task", "UAVApplication": "application"},
)
