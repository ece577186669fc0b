"""UAV racing under attack: the shape of the track; Q is the share of gates passed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Frame, Scored, validate_seeds, validate_world
from sada_gym.envs.episodes.acting import Rollout, play
from sada_gym.envs.episodes.application import EpisodesApplication
from sada_gym.envs.uav.agent.pilot import Pilot, PilotLike, as_pilot
from sada_gym.envs.uav.agent.privileged import PrivilegedPilot
from sada_gym.envs.uav.course import benchmark_starts
from sada_gym.envs.uav.episodes import Ending, Races, Start
from sada_gym.envs.uav.world.templates import template
from sada_gym.envs.uav.world.track import Tracks
from sada_gym.parameters import Mu

LOCKSTEP = 64
"""The most races that are flown at a time."""


class UAVApplication(EpisodesApplication[Races]):
    """A frozen pilot on tracks between displaced anchor points.

    Args:
        anchors: 3, 4 or 5 anchor points.
        agent: A shipped pilot's name, a file of weights, a perception network, an SB3 model, or a
            `Pilot` as it is.
        agent_id: Names an in-memory model in evaluation stores; by default a hash of its weights.

    Raises:
        UserError: If there is no such track or agent, the agent's spaces are not the task's, or its
            weights are not finite numbers.
    """

    name = "SADA-UAV"
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
        super().__init__(agent, agent_id)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"anchors": self.anchors}

    def _as_agent(self, given: Any) -> Pilot:
        return as_pilot(given)

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> Races:
        """Begin the races in the worlds of mu, n of them; close them after use."""
        return Races(benchmark_starts(self.template.tracks(mu), seeds))

    def reference_score(
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

    def feasible(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> npt.NDArray[np.bool_]:
        """Say on which tracks the privileged pilot is not fooled, (n,); arguments as `evaluate`."""
        passed: npt.NDArray[np.bool_] = self.reference_score(mu, seeds) > self.fooling_threshold
        return passed

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scores, extras = [], []
        for tracks, races in self._flown(self.acting, mu, seeds):
            scores.append(races.score)
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
                        "kept": float(tracks.kept[i]),
                    }
                )
        return Scored(np.concatenate(scores), extras)

    def _flown(self, pilot: Pilot, mu: Mu, seeds: Sequence[int]) -> Iterator[tuple[Tracks, Races]]:
        """Fly the races of mu to their ends, `LOCKSTEP` at a time."""
        for start in range(0, len(mu), LOCKSTEP):
            rows = slice(start, start + LOCKSTEP)
            tracks = self.template.tracks(mu[rows])
            with closing(Races(benchmark_starts(tracks, seeds[rows]))) as races:
                play(pilot, races)
                yield tracks, races

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image where the pilot first misses, beside a map of the race."""
        from sada_gym.envs.uav.pictures import summary

        return summary(self.rollouts(mu, seed)[0])

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the camera's image at the start."""
        from sada_gym.envs.uav.pictures import observation

        row, seed = validate_world(self.parameters, mu, seed)
        (start,) = benchmark_starts(self.template.tracks(row), [seed])
        return observation(start, start.state)

    def _frames(self, rollouts: list[Rollout[Start]]) -> list[Frame]:
        from sada_gym.envs.uav.pictures import frames

        return frames(rollouts[0])
