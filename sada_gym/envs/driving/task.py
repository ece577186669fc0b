"""SADA-DrivingTask: the inner task, on which drivers are trained."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.episodes import (
    POLICY_HZ,
    DriveDistribution,
    DrivingEnd,
    DrivingEpisodes,
    DrivingStart,
)
from sada_gym.envs.driving.world.route import CRUISE_M_S
from sada_gym.envs.driving.world.town import LANE_WIDTH_M
from sada_gym.envs.episodes.task import Task, TaskEnv, TaskVectorEnv
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.lockstep import SAME_STEP

ARRIVAL_REWARD, FAILURE_REWARD = 10.0, -10.0


class DrivingTask(Task[DrivingEpisodes]):
    """Drives from a start distribution, and their rewards."""

    episodes_class, distribution_class = DrivingEpisodes, DriveDistribution

    def _begin(self, starts: Sequence[DrivingStart]) -> DrivingEpisodes:
        return DrivingEpisodes(camera(self.distribution.layout), starts)

    def _step(self, episodes: DrivingEpisodes, actions: npt.NDArray[Any]) -> Floats:
        before = episodes.progress_m.copy()
        episodes.step(np.arange(len(episodes)), actions)
        pace = np.clip((episodes.progress_m - before) * POLICY_HZ / CRUISE_M_S, -1.0, 1.0)
        off = np.minimum(np.abs(episodes.lateral_m) / (LANE_WIDTH_M / 2), 1.0)
        end = np.where(episodes.ending == DrivingEnd.ARRIVED, ARRIVAL_REWARD, 0.0)
        end = np.where(episodes.ending == DrivingEnd.LEFT_LANE, FAILURE_REWARD, end)
        reward: Floats = pace * (1.0 - 0.5 * off) + end
        return reward

    def ended(self) -> tuple[Bools, Bools]:
        """Say which drives are terminated, and which are truncated: out of time."""
        ending = self.episodes.ending
        truncated = ending == DrivingEnd.TOO_LATE
        return (ending != DrivingEnd.UNDER_WAY) & ~truncated, truncated

    def info(self, i: int) -> dict[str, Any]:
        """Say where car i is."""
        return {
            "progress_m": float(self.episodes.progress_m[i]),
            "lateral_m": float(self.episodes.lateral_m[i]),
            "is_success": bool(self.episodes.ending[i] == DrivingEnd.ARRIVED),
        }


class DrivingTaskEnv(TaskEnv):
    """A car with a camera follows a route through a town.

    ## Description
    The car is highway-env's, at 15 Hz; the driver decides at 5 Hz. It gets the image of a camera at
    the car's front, the car's speed, and at junctions a command that says where to go. Town, light
    and weather are our own procedures; no photograph is involved.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: steering, 1 is 45° to the right; acceleration, 1 is 5 m/s². Brakes
    stop the car and do not reverse it.

    ## Observation Space
    `Dict`:

    | key | space | what |
    | --- | --- | --- |
    | `image` | `Box(0, 255, (44, 100, 3), uint8)` | what the camera sees |
    | `speed` | `Box(0, 1, (1,), float32)` | in 15 m/s |
    | `command` | `Box(0, 1, (4,), float32)` | one-hot: follow, left, right, straight |

    ## Rewards
    A step: the distance made along the route as a share of that at 8 m/s, from -1 to 1, times 1 in
    the lane's middle to 1/2 at its edge. In addition, +10 on arrival and -10 where the car leaves
    its lane.

    ## Starting State
    A random route from the distribution: it passes 1 to 4 corners and never turns back.

    ## Episode End
    Terminated on arrival, or when no part of the car is in its lane any more (its middle is 2.75 m
    from the lane's). Truncated after the time that the route takes at 10 km/h. `info` holds
    `progress_m`, `lateral_m`, `is_success`.

    ## Arguments
    - `distribution=DriveDistribution()`: draws routes, weathers, mounts and starts.
    - `render_mode=None`: `"rgb_array"` gives the camera's image.

    ## Version History
    - v0: initial version.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012
    task_class = DrivingTask


class DrivingTaskVectorEnv(TaskVectorEnv):
    """`DrivingTaskEnv` in lockstep, see `TaskVectorEnv`."""

    metadata: dict[str, Any] = {**DrivingTaskEnv.metadata, **SAME_STEP}  # noqa: RUF012
    task_class = DrivingTask
