"""UAV racing under attack: the shape of the track; Q is the share of gates passed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.application import Application, Frame, Scored, validate_seeds, validate_world
from sada_gym.envs.uav.agent.pilot import Pilot, PilotLike, as_pilot
from sada_gym.envs.uav.agent.privileged import PrivilegedPilot
from sada_gym.envs.uav.course import benchmark_starts
from sada_gym.envs.uav.episodes import REPLAY_HZ, Ending, OnStep, Races, Rollout, record
from sada_gym.envs.uav.world.templates import template
from sada_gym.envs.uav.world.track import Tracks, line
from sada_gym.parameters import Mu

LOCKSTEP = 64
"""The most races that are flown at a time."""


class UAVApplication(Application):
    """A frozen pilot flies a racing drone through eight gates.

    ## Description
    Three, four or five anchor points control a closed quadratic B-spline; eight gates stand on it
    at equal arc length and face along it. The adversary moves the anchor points: turns become
    sharper, and on a short track gates stand close together. The score Q is the share of the gates
    that the drone passes on one lap. Where it does not pass a gate in 10 s, or is lost, the gate is
    missed: the drone is set back at rest into the last gate that it passed, and the race goes on to
    the gate after the missed one. Hitting a frame is not a miss. The drone is a rigid body in
    PyBullet; templates, ranges and spacing are our own, since the paper's were never published. The
    seed fixes light and background, and moves the start by up to 0.3 m along x and y, and 5
    degrees.

    ## Action Space
    `Box(-1, 1, (2 anchors,), float32)`: the displacements of the anchor points along x and y, the
    first point's first, linear from minus to plus the range:

    | anchors | size | range in m |
    | --- | --- | --- |
    | 3 | 6 | 18.5 |
    | 4 | 8 | 15 |
    | 5 | 10 | 13 |

    For every mu all frames are at least 0.9 m apart. Where they would not be, as for one uniform mu
    in twenty, all displacements are reduced by the same share until they are. `parameters` in
    `info` are the displacements before that; the track has `kept` times these.

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
    `passed`, `late` or `lost`), `touched` (whether the drone hit anything on its way to each gate),
    `time_s` (the time for the course), and of the track `length_m`, `sharpest_turn_deg` (the
    greatest turn from the start or a gate to the next, of more than 180 where the track loops),
    `closest_m` (the smallest distance between two frames) and `kept` (how much of the displacements
    was kept, 1 but for one uniform mu in twenty).

    ## Arguments
    - `anchors=3`: 3, 4 or 5; each has an id of its own, such as `SADA-UAV-4Anchors-v0`.
    - `agent="waypoint-pid"`: a shipped pilot (`waypoint-pid`, `ppo`), a file of weights that our
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
        agent: str | Path | PilotLike = "waypoint-pid",
        agent_id: str | None = None,
    ) -> None:
        self.template, self.anchors = template(anchors), int(anchors)
        self.parameters = self.template.parameters
        self.agent_name, self.agent = agents.resolve(agent, self.name, agent_id)
        self._pilot = as_pilot(self.agent)
        self._agent_id = agent_id

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"anchors": self.anchors}

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the pilot's weights, or over its `agent_id` and how it is used."""
        pilot, use = self._pilot, getattr(self._pilot, "use", None)
        return agents.identity(pilot.fingerprint, self.agent, self._agent_id, use)

    def tracks(self, mu: Mu) -> Tracks:
        """The tracks of mu, (n, d)."""
        return Tracks(self.template.displaced(mu))

    def races(self, mu: Mu, seeds: Sequence[int]) -> Races:
        """Drones at the starts of the tracks of mu, n of them; close them after use."""
        return Races(benchmark_starts(self.tracks(mu), seeds))

    def fly(self, races: Races, on_step: OnStep | None = None) -> None:
        """Let the pilot fly all races to their ends; `on_step` is called before every decision."""
        _fly(self._pilot, races, on_step)

    def rollout(self, mu: npt.ArrayLike, seed: int) -> Rollout:
        """Fly the race in the world of one mu, (d,), and keep every decision."""
        row, seed = validate_world(self.parameters, mu, seed)
        races = self.races(row, [seed])
        try:
            name = f"{self.anchors} anchors"
            way = line(self.template.displaced(row)[0])
            return record(races, self.fly, name=name, line=way)
        finally:
            races.close()

    def reference_score(
        self, mu: npt.ArrayLike, seeds: Sequence[int] | None = None
    ) -> npt.NDArray[np.float64]:
        """The privileged pilot's scores: where it passes, a failure is the agent's own.

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
        scores = np.empty(len(batch))
        for rows, races in self._batches(batch, checked):
            _fly(PrivilegedPilot(), races)
            scores[rows] = races.score
        return scores

    def feasible(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> npt.NDArray[np.bool_]:
        """On which tracks the privileged pilot is not fooled, (n,); arguments as `evaluate`."""
        passed: npt.NDArray[np.bool_] = self.reference_score(mu, seeds) > self.fooling_threshold
        return passed

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = np.empty(len(mu)), []
        for rows, races in self._batches(mu, seeds):
            self.fly(races)
            scores[rows] = races.score
            tracks = self.tracks(mu[rows])
            kept = self.template.kept(mu[rows])
            sharpest, closest = tracks.sharpest_turn_deg(), tracks.closest_m()
            for i in range(len(races)):
                ended = races.endings[i]
                extras.append(
                    {
                        "gates_passed": int((ended == Ending.PASSED).sum()),
                        "endings": [Ending(code).name.lower() for code in ended],
                        "touched": races.touched[i].tolist(),
                        "time_s": float(races.time_s[i]),
                        "length_m": float(tracks.length_m[i]),
                        "sharpest_turn_deg": float(sharpest[i]),
                        "closest_m": float(closest[i]),
                        "kept": float(kept[i]),
                    }
                )
        return Scored(scores, extras)

    def _batches(self, mu: Mu, seeds: Sequence[int]) -> Iterator[tuple[slice, Races]]:
        for start in range(0, len(mu), LOCKSTEP):
            rows = slice(start, min(start + LOCKSTEP, len(mu)))
            races = self.races(mu[rows], seeds[rows])
            try:
                yield rows, races
            finally:
                races.close()

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The camera's image where the pilot first misses, beside a map of the race."""
        from sada_gym.envs.uav.pictures import summary

        return summary(self.rollout(mu, seed))

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """The camera's image at the start."""
        from sada_gym.envs.uav.pictures import observation

        row, seed = validate_world(self.parameters, mu, seed)
        (start,) = benchmark_starts(self.tracks(row), [seed])
        return observation(start, start.state)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """The whole race: the camera's image beside a map."""
        from sada_gym.envs.uav.pictures import frames

        rollout = self.rollout(mu, seed)
        return frames(rollout), rollout.score


def _fly(pilot: Pilot, races: Races, on_step: OnStep | None = None) -> None:
    pilot.start(len(races))
    while len(which := races.under_way()):
        if on_step is not None:
            on_step(races)
        races.step(which, pilot.act(races, which))
