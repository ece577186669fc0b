"""SADA-DrivingMetaDriveTask: the inner task, on which drivers are trained."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.episodes.task import Task, TaskEnv, TaskVectorEnv
from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.envs.metadrive.start import POLICY_HZ, DriveDistribution, DriveEnd
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.lockstep import SAME_STEP


class DriveTask(Task[DriveEpisodes]):
    """Drives from a start distribution, and MetaDrive's rewards."""

    episodes_class, distribution_class = DriveEpisodes, DriveDistribution

    def _step(self, episodes: DriveEpisodes, actions: npt.NDArray[Any]) -> Floats:
        episodes.step(np.arange(len(episodes)), actions)
        return episodes.reward.copy()

    def ended(self) -> tuple[Bools, Bools]:
        """Say whether the drive is terminated, and whether it is truncated: out of time."""
        ending = self.episodes.ending
        truncated = ending == DriveEnd.TOO_LATE
        return (ending != DriveEnd.UNDER_WAY) & ~truncated, truncated

    def info(self, i: int) -> dict[str, Any]:
        """Say how far the car is."""
        return {
            "route_done": float(self.episodes.done[i]),
            "is_success": bool(self.episodes.ending[i] == DriveEnd.ARRIVED),
        }


class DriveTaskEnv(TaskEnv):
    """A car follows a route in MetaDrive, among others; a process can have one such environment.

    ## Description
    The car decides at 10 Hz how it steers, accelerates and brakes. Its route leads over two blocks
    of road that MetaDrive draws; other drivers are MetaDrive's IDM.

    ## Action Space
    `Box(-1, 1, (2,), float32)`: steering, 1 is 40° to the left; and throttle, or brake below 0.

    ## Observation Space
    `Dict`:

    | key | space | what |
    | --- | --- | --- |
    | `lidar` | `Box(0, 1, (240,), float32)` | how far the return of each ray is in 50 m, ahead first, then to the left; 1 where there is none |
    | `state` | `Box(0, 1, (35,), float32)` | MetaDrive's own observation of the car (0 to 8), of the next two checkpoints (9 to 18) and of the four nearest cars (19 to 34) |

    ## Rewards
    MetaDrive's own: metres along the lane, a little for speed, +10 on arrival, -5 for a crash or
    for leaving the road.

    ## Starting State
    The car stands at the start of a random scene.

    ## Episode End
    Terminated on arrival, at a crash, or off the road. Truncated 5 s after the time that the route
    takes at 15 km/h. `info` holds `route_done` and `is_success`.

    ## Arguments
    - `distribution=DriveDistribution()`: what scenes and conditions are drawn from.
    - `render_mode=None`: `"rgb_array"` draws the road from above.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012
    task_class = DriveTask


class DriveTaskVectorEnv(TaskVectorEnv):
    """`DriveTaskEnv` as a batch of one, see `TaskVectorEnv`."""

    metadata: dict[str, Any] = {**DriveTaskEnv.metadata, **SAME_STEP}  # noqa: RUF012
    task_class = DriveTask
