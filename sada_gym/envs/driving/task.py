"""SADA-DrivingTask: the inner task, on which drivers are trained."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from sada_gym.application import Frame
from sada_gym.envs.checks import (
    checked_actions,
    checked_num_envs,
    checked_render_mode,
    reset_mask,
    spread_seeds,
    warn_without_render_mode,
)
from sada_gym.envs.driving.camera import camera
from sada_gym.envs.driving.course import Course
from sada_gym.envs.driving.drives import (
    PICTURE_COLUMNS,
    PICTURE_ROWS,
    POLICY_HZ,
    Drives,
    Ending,
    Observation,
    Start,
)
from sada_gym.envs.driving.expert import CRUISE_M_S
from sada_gym.envs.driving.route import COMMANDS
from sada_gym.envs.driving.town import LANE_WIDTH_M

ARRIVAL_REWARD, FAILURE_REWARD = 10.0, -10.0

_FIRST = np.zeros(1, np.intp)

OBSERVATION_SPACE = spaces.Dict(
    {
        "command": spaces.Box(0.0, 1.0, (len(COMMANDS),), np.float32),
        "image": spaces.Box(0, 255, (PICTURE_ROWS, PICTURE_COLUMNS, 3), np.uint8),
        "speed": spaces.Box(0.0, 1.0, (1,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)


class DrivingTaskEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """A car with a camera follows a route through a town.

    ## Description
    The car is highway-env's, at 15 Hz; the driver decides at 5 Hz. It sees what a camera at the
    car's front sees, feels its speed, and is told at junctions where to go. Town, light and weather
    are our own procedures, no photograph is involved.

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
    A step: the way made along the route over that at 8 m/s, from -1 to 1, times 1 in the lane's
    middle to 1/2 at its edge. Besides, +10 on arrival and -10 where the car leaves its lane.

    ## Starting State
    A random route from the course: it passes 1 to 4 corners and never turns back.

    ## Episode End
    Terminated on arrival, or when no part of the car is in its lane any more (its middle is 2.75 m
    from the lane's). Truncated when the route would have been driven at 10 km/h. `info` holds
    `progress_m`, `lateral_m`, `is_success`.

    ## Arguments
    - `course=Course()`: what routes, weathers, mounts and ways to set off are drawn from.
    - `render_mode=None`: `"rgb_array"` gives the camera's picture.

    ## Version History
    - v0: initial version.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012

    def __init__(self, course: Course | None = None, *, render_mode: str | None = None) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        # a copy: SB3's VecNormalize changes the space that it is given
        self.observation_space: spaces.Dict = deepcopy(OBSERVATION_SPACE)  # type: ignore[assignment]
        self.action_space = ACTION_SPACE
        self._lessons = _Lessons(course or Course(), 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set off on a new route."""
        super().reset(seed=seed, options=options)
        self._lessons.start(0, self.np_random)
        return self._observation(), self._lessons.info(0)

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for a fifth of a second."""
        reward = self._lessons.step(checked_actions(action, self.action_space, "an action")[None])
        terminated, truncated = self._lessons.over()
        info = self._lessons.info(0)
        return self._observation(), float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Frame | None:
        """Give the camera's picture."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        frame: Frame = self._lessons.drives.look(_FIRST)[0]
        return frame

    def _observation(self) -> Observation:
        return {key: value[0] for key, value in self._lessons.drives.observe(_FIRST).items()}


class DrivingTaskVectorEnv(gym.vector.VectorEnv[Observation, npt.NDArray[Any], npt.NDArray[Any]]):
    """`DrivingTaskEnv` in lockstep, as `SyncVectorEnv` with `AutoresetMode.SAME_STEP` has it.

    Args:
        course: What routes, weathers, mounts and ways to set off are drawn from.
        num_envs: Number of cars.
        render_mode: `"rgb_array"` gives each camera's picture.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        **DrivingTaskEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self, course: Course | None = None, *, num_envs: int = 1, render_mode: str | None = None
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self.num_envs = checked_num_envs(num_envs)
        self.single_observation_space: spaces.Dict = deepcopy(OBSERVATION_SPACE)
        self.single_action_space = ACTION_SPACE
        self.observation_space = batch_space(OBSERVATION_SPACE, num_envs)
        self.action_space = batch_space(ACTION_SPACE, num_envs)
        self._lessons = _Lessons(course or Course(), num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]
        self._everyone = np.arange(num_envs)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """One generator a car."""
        return tuple(self._generators)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Set off on new routes, all or those in the boolean array `options["reset_mask"]`.

        Args:
            seed: An int (car i gets seed + i) or a sequence of one seed a car.
            options: `reset_mask`, (num_envs,) bool, where only some are to be reset.
        """
        seeds = spread_seeds(seed, self.num_envs)
        for i in reset_mask(options, self.num_envs):
            given = seeds[i]
            if given is not None:
                self._generators[i] = seeding.np_random(given)[0]
            self._lessons.start(i, self._generators[i])
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            infos = self._add_info(infos, self._lessons.info(i), i)
        return self._lessons.drives.observe(self._everyone), infos

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Observation,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Drive for a fifth of a second; who has ended sets off anew."""
        reward = self._lessons.step(checked_actions(actions, self.action_space, "actions"))
        terminated, truncated = self._lessons.over()
        over = np.flatnonzero(terminated | truncated)
        last = self._lessons.drives.observe(over)
        infos: dict[str, Any] = {}
        for i in self._everyone.tolist():
            info = self._lessons.info(i)
            if terminated[i] or truncated[i]:
                row = int(np.searchsorted(over, i))
                seen = {key: value[row] for key, value in last.items()}
                infos = self._add_info(infos, {"final_obs": seen, "final_info": info}, i)
                self._lessons.start(i, self._generators[i])
                info = self._lessons.info(i)
            infos = self._add_info(infos, info, i)
        observation = self._lessons.drives.observe(self._everyone)
        return observation, reward, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Give each camera's picture."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return tuple(self._lessons.drives.look(self._everyone))


class _Lessons:
    """Drives of a course, with what each step is worth: for scalar and vector alike."""

    def __init__(self, course: Course, count: int) -> None:
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
        """Let car i set off on a new route."""
        start = self._course.draw(rng)
        if self._drives is not None:
            self._drives.begin(i, start)
            return
        self._waiting[i] = start
        if len(self._waiting) == self._count:
            starts = [self._waiting[k] for k in range(self._count)]
            self._drives = Drives(camera(self._course.layout), starts)

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Drive, and give what it was worth, (n,)."""
        drives = self.drives
        if drives.ending.any():
            raise ResetNeeded("Expected reset() before step(): a drive has ended.")
        before = drives.progress_m.copy()
        drives.step(np.arange(len(drives)), np.clip(actions, -1.0, 1.0))
        pace = np.clip((drives.progress_m - before) * POLICY_HZ / CRUISE_M_S, -1.0, 1.0)
        off = np.minimum(np.abs(drives.lateral_m) / (LANE_WIDTH_M / 2), 1.0)
        end = np.where(drives.ending == Ending.ARRIVED, ARRIVAL_REWARD, 0.0)
        end = np.where(drives.ending == Ending.LEFT_LANE, FAILURE_REWARD, end)
        worth: npt.NDArray[np.float64] = pace * (1.0 - 0.5 * off) + end
        return worth

    def over(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Which cars have ended, and for which time is up."""
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
