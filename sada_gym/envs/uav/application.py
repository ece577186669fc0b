"""UAV racing under attack: the shape of the track; Q is the share of gates passed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Scored
from sada_gym.envs.episodes.closed_loop import EpisodesApplication
from sada_gym.envs.episodes.rollout import Rollout, play
from sada_gym.envs.uav.agent.pilot import Pilot, PilotLike, as_pilot
from sada_gym.envs.uav.agent.privileged import PrivilegedPilot
from sada_gym.envs.uav.episodes import REPLAY_HZ, RacingEpisodes, RacingStart
from sada_gym.envs.uav.start_distribution import benchmark_starts
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.templates import template
from sada_gym.envs.uav.world.track import Tracks
from sada_gym.frames import Frame
from sada_gym.parameters import Mu
from sada_gym.seeds import validate_seeds, validate_world

if TYPE_CHECKING:
    from sada_gym.frames import LegendEntry

LOCKSTEP = 64
"""The most races that are flown at a time."""


class UAVApplication(EpisodesApplication[RacingEpisodes]):
    """A frozen pilot flies a racing drone through eight gates.

    ## Description
    Three, four or five anchor points control a closed curve, a quadratic B-spline. Eight gates
    stand on it at equal distances and face along it. The adversary moves the anchor points: turns
    become sharper, and gates stand closer together or farther apart. The score Q is the share of
    the gates that the drone passes on one lap. The drone misses a gate where it touches a frame or
    the ground, does not pass the gate in 10 s, or leaves the world. Then it is set back at rest
    into the last gate that it passed, and the race goes on to the gate after the missed one. The
    drone is a rigid body in PyBullet. The seed fixes light and background, and moves the start by
    up to 0.3 m along x and y, and by up to 5 degrees.

    ## Action Space
    `Box(-1, 1, (2 anchors,), float32)`: for each anchor point in turn, how far it is moved
    along x and along y; -1 to 1 are minus to plus the range:

    | anchors | size | range in m |
    | --- | --- | --- |
    | 3 | 6 | 18.5 |
    | 4 | 8 | 15 |
    | 5 | 10 | 13 |

    Frames are at least 0.9 m apart. Where mu would put them closer, as one uniform mu in twenty
    does, all displacements are reduced by the same share. `parameters` in `info` are the
    displacements before that; the track has `kept` times these.

    ## Observation Space
    `Box(-1, 1, (2 anchors + 2,), float32)`: last mu, last score, share of the steps left; zeros
    where there is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the share of gates passed.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.7), `seed`, `parameters`, `gates_passed`, `endings` (for each gate
    `passed`, `hit`, `late` or `lost`), `time_s` (the time for the lap), and of the track
    `length_m`, `sharpest_turn_deg` (the greatest turn from the start or a gate to the next, of more
    than 180 where the track loops), `closest_m` (the smallest distance between two frames) and
    `kept` (how much of the displacements was kept, 1 but for one uniform mu in twenty).

    ## Arguments
    - `anchors=3`: 3, 4 or 5; each has an id of its own, such as `SADA-UAV-4Anchors-v0`.
    - `agent="ppo"`: a shipped pilot (`ppo`, `waypoint-pid`), a file of weights that our
      training scripts wrote, a perception network (`WaypointNetwork`), or an SB3 model trained on
      `SADA-RacingTask-v0`.
    - `agent_id=None`: names an in-memory model in evaluation stores; by default a hash of its
      weights.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-UAV"
    render_fps = REPLAY_HZ
    fooling_threshold = 0.7
    sample_size = 100

    def __init__(
        self,
        anchors: int = 3,
        *,
        agent: str | Path | PilotLike = "ppo",
        agent_id: str | None = None,
    ) -> None:
        self.template, self.anchors = template(anchors), int(anchors)
        self.parameters = self.template.parameters
        super().__init__(agent, agent_id)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the marks in frames mean."""
        from sada_gym.envs.uav.frame import LEGEND

        return LEGEND

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"anchors": self.anchors}

    def _as_agent(self, given: Any) -> Pilot:
        return as_pilot(given)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> RacingEpisodes:
        """Begin the races in the worlds of mu, n of them; close them after use."""
        return RacingEpisodes(benchmark_starts(self.template.tracks(mu), seeds))

    def privileged_score(
        self, mu: npt.ArrayLike, seeds: Sequence[int] | None = None
    ) -> npt.NDArray[np.float64]:
        """Score the privileged pilot: where it passes, a failure is the agent's own.

        Args:
            mu: (n, d), values in [-1, 1].
            seeds: n seeds; 0 for all by default.

        Returns:
            (n,) Q of the guidance that gets the gates' true poses.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        batch = self.parameters.validate(mu)
        checked = [0] * len(batch) if seeds is None else validate_seeds(seeds, len(batch))
        scores = [races.score for _, races in self._flown(PrivilegedPilot(), batch, checked)]
        return np.concatenate([np.empty(0), *scores])

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = [], []
        for tracks, races in self._flown(self.policy, mu, seeds):
            scores.append(races.score)
            sharpest, closest = tracks.sharpest_turn_deg(), tracks.closest_m()
            for i in range(len(races)):
                ended = races.endings[i]
                extras.append(
                    {
                        "gates_passed": int((ended == GateOutcome.PASSED).sum()),
                        "endings": [GateOutcome(code).name.lower() for code in ended],
                        "time_s": float(races.time_s[i]),
                        "length_m": float(tracks.length_m[i]),
                        "sharpest_turn_deg": float(sharpest[i]),
                        "closest_m": float(closest[i]),
                        "kept": float(tracks.kept[i]),
                    }
                )
        return Scored(np.concatenate(scores), extras)

    def _flown(
        self, pilot: Pilot, mu: Mu, seeds: Sequence[int]
    ) -> Iterator[tuple[Tracks, RacingEpisodes]]:
        """Fly the races of mu to their ends, `LOCKSTEP` at a time."""
        for start in range(0, len(mu), LOCKSTEP):
            rows = slice(start, start + LOCKSTEP)
            tracks = self.template.tracks(mu[rows])
            races = RacingEpisodes(benchmark_starts(tracks, seeds[rows]))
            play(pilot, races)
            yield tracks, races

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image where the pilot first misses, beside a map of the race."""
        one: Any = [mu]
        return next(self.render_batch(one, [seed]))

    def render_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw such frames of several worlds, whose episodes go on in lockstep."""
        from sada_gym.envs.uav.frame import summary

        for rollouts in self.rollouts_batch(mu, seeds):
            yield summary(rollouts[0])

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image at the start."""
        from sada_gym.envs.uav.frame import observation

        row, seed = validate_world(self.parameters, mu, seed)
        (start,) = benchmark_starts(self.template.tracks(row), [seed])
        return observation(start, start.state)

    def _frames(self, rollouts: list[Rollout[RacingStart]]) -> list[Frame]:
        from sada_gym.envs.uav.frame import frames

        return frames(rollouts[0])
