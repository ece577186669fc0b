"""SADA-RacingTask: the inner task, on which racing pilots are trained."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from sada_gym.envs.checks import check_kind
from sada_gym.envs.task import TaskEnv, TaskVectorEnv
from sada_gym.envs.uav.course import Course
from sada_gym.envs.uav.episodes import GATES_AHEAD, POLICY_HZ, Ending, Observation, Races, Start
from sada_gym.envs.uav.world.track import GATES

PROGRESS_REWARD_PER_M, GATE_REWARD, MISS_REWARD, TOUCH_REWARD = 0.5, 2.0, -5.0, -0.5

OBSERVATION_SPACE = spaces.Dict(
    {
        "gates": spaces.Box(-1.0, 1.0, (5 * GATES_AHEAD,), np.float32),
        "motion": spaces.Box(-1.0, 1.0, (9,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (4,), np.float32)


class RacingTaskEnv(TaskEnv):
    """A racing drone flies a lap through eight gates.

    ## Description
    The drone is a rigid body in PyBullet with a flight controller at 240 Hz; the pilot decides at
    20 Hz. It gets the places of the next two gates, and no image. A gate is passed when the drone
    crosses its opening, in its direction and in the gates' order. Frames are solid.

    ## Action Space
    `Box(-1, 1, (4,), float32)`: wanted velocity to where the drone heads, to its left and up, 1 is
    16 m/s (over the ground both together at most 16 m/s); turning rate, 1 is 4 rad/s to the left.

    ## Observation Space
    `Dict`; the level frame has x to where the drone heads, y to the left, z up:

    | key | space | what |
    | --- | --- | --- |
    | `gates` | `Box(-1, 1, (10,), float32)` | of the next gate and the one after it: the opening's x, y, z in the level frame, in 20 m, and cosine and sine of its heading there |
    | `motion` | `Box(-1, 1, (9,), float32)` | velocity in the level frame, in 16 m/s; the world's up in the drone's frame; turning rates about the drone's axes, in 10 rad/s |

    ## Rewards
    A step: 0.5 for every metre nearer to the next gate's opening, 2 for a gate passed, -5 for a
    gate missed, and -0.5 where, for the first time on the way to a gate, a frame or the ground is
    touched.

    ## Starting State
    Between two gates of a random track of the course, flying.

    ## Episode End
    Terminated after the last gate, or where the drone is lost: on its back on the ground, or out of
    the world. Truncated when a gate was not passed in 10 s: the last observation is then of the
    drone set back at the last gate, where the race would go on to the gate after the missed one.
    `info` holds `gates_passed`, `time_s`, `is_success`.

    ## Arguments
    - `course=Course()`: what tracks and starts are drawn from.
    - `render_mode=None`: `"rgb_array"` gives the image of the drone's camera.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012

    def __init__(self, course: Course | None = None, *, render_mode: str | None = None) -> None:
        super().__init__(_Episodes(course, 1), render_mode=render_mode)


class RacingTaskVectorEnv(TaskVectorEnv):
    """`RacingTaskEnv` in lockstep, as `SyncVectorEnv` with `AutoresetMode.SAME_STEP` has it.

    Args:
        course: What tracks and starts are drawn from.
        num_envs: Number of drones.
        render_mode: `"rgb_array"` gives the image of each drone's camera.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        **RacingTaskEnv.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self, course: Course | None = None, *, num_envs: int = 1, render_mode: str | None = None
    ) -> None:
        episodes = _Episodes(course, num_envs)
        super().__init__(episodes, num_envs=num_envs, render_mode=render_mode)


class _Episodes:
    """Races of a course and their rewards: `TaskEpisodes`."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def __init__(self, course: Course | None, count: int) -> None:
        course = Course() if course is None else course
        check_kind("course", course, Course)
        self._course, self._count = course, count
        self._waiting: dict[int, Start] = {}
        self._races: Races | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the races, which live in the process that began them: a copy needs a reset."""
        return {**self.__dict__, "_races": None, "_waiting": {}}

    @property
    def races(self) -> Races:
        """The drones."""
        if self._races is None:
            raise ResetNeeded("Expected reset() first: no drone has set off yet.")
        return self._races

    def start(self, i: int, rng: np.random.Generator) -> None:
        """Let drone i start on a new track."""
        start = self._course.draw(rng)
        if self._races is not None:
            self._races.begin(i, start)
            return
        self._waiting[i] = start
        if len(self._waiting) == self._count:
            self._races = Races([self._waiting[k] for k in range(self._count)])

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Fly, and give the rewards, (n,)."""
        races = self.races
        if np.logical_or(*self.ended()).any():
            raise ResetNeeded("Expected reset() before step(): a race has ended.")
        everyone = np.arange(len(races))
        gate = races.next_gate.copy()
        touched = races.touched.copy()
        before = self._distances(gate)
        races.step(everyone, actions)
        ended = races.endings[everyone, gate]
        passed, missed = ended == Ending.PASSED, ended > Ending.PASSED
        nearer = np.where(passed, before, before - self._distances(gate))
        reward: npt.NDArray[np.float64] = (
            PROGRESS_REWARD_PER_M * np.where(missed, 0.0, nearer)
            + GATE_REWARD * passed
            + MISS_REWARD * missed
            + TOUCH_REWARD * (races.touched & ~touched).any(axis=1)
        )
        return reward

    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Which races are terminated, and which truncated: out of time."""
        endings = self.races.endings
        late = (endings == Ending.LATE).any(axis=1)
        done = (endings == Ending.LOST).any(axis=1) | (endings[:, -1] == Ending.PASSED)
        return done, late

    def info(self, i: int) -> dict[str, Any]:
        """How far drone i has come."""
        passed = int((self.races.endings[i] == Ending.PASSED).sum())
        return {
            "gates_passed": passed,
            "time_s": float(self.races.time_s[i]),
            "is_success": passed == GATES,
        }

    def observe(self, which: npt.NDArray[np.intp]) -> Observation:
        """Observations of some of the pilots."""
        return self.races.observe(which)

    def render(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8]:
        """Images of some of the cameras."""
        return self.races.render(which)

    def close(self) -> None:
        """Free the drones' worlds."""
        if self._races is not None:
            self._races.close()
            self._races = None
            self._waiting = {}

    def _distances(self, gate: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
        """How far drones are from the openings of some gates, (n,)."""
        races = self.races
        centres = races.gates[np.arange(len(races)), gate, :3]
        away: npt.NDArray[np.float64] = np.sqrt(((races.states[:, :3] - centres) ** 2).sum(axis=1))
        return away
