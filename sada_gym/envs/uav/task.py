"""SADA-RacingTask: the inner task, on which racing pilots are trained."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.episodes.task import Task, TaskEnv, TaskVectorEnv
from sada_gym.envs.uav.episodes import POLICY_HZ, RaceDistribution, RacingEpisodes
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import GATES
from sada_gym.foundations.arrays import Bools, Floats, Indices
from sada_gym.foundations.lockstep import SAME_STEP

PROGRESS_REWARD_PER_M, GATE_REWARD, MISS_REWARD = 0.5, 2.0, -5.0


class RacingTask(Task[RacingEpisodes]):
    """Races from a start distribution, and their rewards."""

    episodes_class, distribution_class = RacingEpisodes, RaceDistribution

    def _step(self, episodes: RacingEpisodes, actions: npt.NDArray[Any]) -> Floats:
        everyone = np.arange(len(episodes))
        gate = episodes.next_gate.copy()
        before = _distances(episodes, gate)
        episodes.step(everyone, actions)
        ended = episodes.endings[everyone, gate]
        passed, missed = ended == GateOutcome.PASSED, ended > GateOutcome.PASSED
        nearer = np.where(passed, before, before - _distances(episodes, gate))
        reward: Floats = (
            PROGRESS_REWARD_PER_M * np.where(missed, 0.0, nearer)
            + GATE_REWARD * passed
            + MISS_REWARD * missed
        )
        return reward

    def ended(self) -> tuple[Bools, Bools]:
        """Say which races are terminated, and which are truncated: out of time."""
        endings = self.episodes.endings
        late = (endings == GateOutcome.LATE).any(axis=1)
        done = np.isin(endings, (GateOutcome.HIT, GateOutcome.LOST)).any(axis=1)
        done |= endings[:, -1] == GateOutcome.PASSED
        return done, late

    def info(self, i: int) -> dict[str, Any]:
        """Say how far drone i has come."""
        passed = int((self.episodes.endings[i] == GateOutcome.PASSED).sum())
        return {
            "gates_passed": passed,
            "time_s": float(self.episodes.time_s[i]),
            "is_success": passed == GATES,
        }


def _distances(races: RacingEpisodes, gate: Indices) -> Floats:
    centres = races.gates[np.arange(len(races)), gate, :3]
    away: Floats = np.sqrt(((races.states[:, :3] - centres) ** 2).sum(axis=1))
    return away


class RacingTaskEnv(TaskEnv):
    """A racing drone flies a lap through eight gates.

    ## Description
    The drone is a rigid body in PyBullet with a flight controller at 240 Hz; the pilot decides at
    20 Hz. It gets the places of the next two gates, and no image. A gate is passed when the drone
    crosses its opening, in its direction and in the gates' order. A drone that touches a frame
    or the ground misses the gate.

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
    A step: 0.5 for every metre nearer to the next gate's opening, 2 for a gate passed, and -5 for a
    gate missed.

    ## Starting State
    Between two gates of a random track of the distribution, flying.

    ## Episode End
    Terminated after the last gate, or where the drone touches a frame or the ground, or leaves the
    world. Truncated when a gate was not passed in 10 s. After a miss the last observation is of the
    drone set back at the last gate, where the race would go on to the gate after the missed one.
    `info` holds `gates_passed`, `time_s`, `is_success`.

    ## Arguments
    - `distribution=RaceDistribution()`: what tracks and starts are drawn from.
    - `render_mode=None`: `"rgb_array"` gives the image of the drone's camera.

    ## Version History
    - v0: initial version.
    """  # noqa: E501 - a table's row

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": POLICY_HZ}  # noqa: RUF012
    task_class = RacingTask


class RacingTaskVectorEnv(TaskVectorEnv):
    """`RacingTaskEnv` in lockstep, see `TaskVectorEnv`."""

    metadata: dict[str, Any] = {**RacingTaskEnv.metadata, **SAME_STEP}  # noqa: RUF012
    task_class = RacingTask
