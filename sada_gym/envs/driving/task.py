"""SADA-DrivingTask: the inner task, on which drivers are trained."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from sada_gym.envs.checks import check_kind
from sada_gym.envs.driving.agent.privileged import CRUISE_M_S
from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.course import Course
from sada_gym.envs.driving.episodes import (
    PICTURE_COLUMNS,
    PICTURE_ROWS,
    POLICY_HZ,
    Drives,
    Ending,
    Observation,
    Start,
)
from sada_gym.envs.driving.world.route import COMMANDS
from sada_gym.envs.driving.world.town import LANE_WIDTH_M
from sada_gym.envs.task import TaskEnv, TaskVectorEnv

ARRIVAL_REWARD, FAILURE_REWARD = 10.0, -10.0

OBSERVATION_SPACE = spaces.Dict(
    {
        "command": spaces.Box(0.0, 1.0, (len(COMMANDS),), np.float32),
        "image": spaces.Box(0, 255, (PICTURE_ROWS, PICTURE_COLUMNS, 3), np.uint8),
        "speed": spaces.Box(0.0, 1.0, (1,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)


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
    A random route from the course: it passes 1 to 4 corners and never turns back.

    ## Episode End
    Terminated on arrival, or when no part of the car is in its lane any more (its middle is 2.75 m
    from the lane's). Truncated when the route would have been driven at 10 km/h. `info` holds
    `progress_m`, `lateral_m`, `is_success`.

    ## Arguments
    - `course=Course()`: what routes, weathers, mounts and starts are drawn from.
    - `render_mode=None`: `"rgb_array"` gives the camera's image.

    ## Version History
    - v0: initial version.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012

    def __init__(self, course: Course | None = None, *, render_mode: str | None = None) -> None:
        super().__init__(_Episodes(course, 1), render_mode=render_mode)


class DrivingTaskVectorEnv(TaskVectorEnv):
    """`DrivingTaskEnv` in lockstep, as `SyncVectorEnv` with `AutoresetMode.SAME_STEP` has it.

    Args:
        course: What routes, weathers, mounts and starts are drawn from.
        num_envs: Number of cars.
        render_mode: `"rgb_array"` gives each camera's image.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        **DrivingTaskEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self, course: Course | None = None, *, num_envs: int = 1, render_mode: str | None = None
    ) -> None:
        episodes = _Episodes(course, num_envs)
        super().__init__(episodes, num_envs=num_envs, render_mode=render_mode)


class _Episodes:
    """Drives of a course and their rewards: `TaskEpisodes`."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def __init__(self, course: Course | None, count: int) -> None:
        course = Course() if course is None else course
        check_kind("course", course, Course)
        self._course, self._count = course, count
        self._waiting: dict[int, Start] = {}
        self._drives: Drives | None = None

    @property
    def drives(self) -> Drives:
        """The cars."""
        if self._drives is None:
            raise ResetNeeded("Expected reset() first: no car has set off yet.")
        return self._drives

    def start(self, i: int, rng: np.random.Generator) -> None:
        """Let car i start on a new route."""
        start = self._course.draw(rng)
        if self._drives is not None:
            self._drives.begin(i, start)
            return
        self._waiting[i] = start
        if len(self._waiting) == self._count:
            starts = [self._waiting[k] for k in range(self._count)]
            self._drives = Drives(camera(self._course.layout), starts)

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Drive, and give the rewards, (n,)."""
        drives = self.drives
        if drives.ending.any():
            raise ResetNeeded("Expected reset() before step(): a drive has ended.")
        before = drives.progress_m.copy()
        drives.step(np.arange(len(drives)), np.clip(actions, -1.0, 1.0))
        pace = np.clip((drives.progress_m - before) * POLICY_HZ / CRUISE_M_S, -1.0, 1.0)
        off = np.minimum(np.abs(drives.lateral_m) / (LANE_WIDTH_M / 2), 1.0)
        end = np.where(drives.ending == Ending.ARRIVED, ARRIVAL_REWARD, 0.0)
        end = np.where(drives.ending == Ending.LEFT_LANE, FAILURE_REWARD, end)
        reward: npt.NDArray[np.float64] = pace * (1.0 - 0.5 * off) + end
        return reward

    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Which drives are terminated, and which truncated: out of time."""
        ending = self.drives.ending
        truncated = ending == Ending.TOO_LATE
        return (ending != Ending.UNDER_WAY) & ~truncated, truncated

    def info(self, i: int) -> dict[str, Any]:
        """Where car i is."""
        return {
            "progress_m": float(self.drives.progress_m[i]),
            "lateral_m": float(self.drives.lateral_m[i]),
            "is_success": bool(self.drives.ending[i] == Ending.ARRIVED),
        }

    def observe(self, which: npt.NDArray[np.intp]) -> Observation:
        """Observations of some of the drivers."""
        return self.drives.observe(which)

    def render(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8]:
        """Images of some of the cameras."""
        return self.drives.render(which)

    def close(self) -> None:
        """Do nothing: cars hold nothing to free."""
