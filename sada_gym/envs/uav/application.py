"""UAV racing under attack: the shape of the track; Q is the share of gates passed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.application import Application, Frame, Scored, validate_seeds, validate_world
from sada_gym.envs.uav.agent.pilot import Pilot, PilotLike, pilot
from sada_gym.envs.uav.agent.privileged import Reference
from sada_gym.envs.uav.course import set_off
from sada_gym.envs.uav.races import Ending, Races
from sada_gym.envs.uav.world.templates import template
from sada_gym.envs.uav.world.track import Tracks
from sada_gym.parameters import Mu

LOCKSTEP = 64
"""So many races are flown at a time."""


class UAVApplication(Application):
    """A frozen pilot on tracks between displaced anchor points.

    Args:
        anchors: 3, 4 or 5 anchor points.
        agent: A shipped pilot's name, a perception network, or an SB3 model.
        agent_id: Names an in-memory model in evaluation stores; by default a hash of its weights.

    Raises:
        ValueError: If there is no such track or agent, or the agent's spaces are not the task's.
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
        if isinstance(agent, str | Path):
            self.agent_name, self.agent = str(agent), agents.load_pilot(agent)
        else:
            self.agent_name, self.agent = agent_id or type(agent).__name__, agent
        self._pilot = pilot(self.agent)
        self._agent_id = agent_id

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {"anchors": self.anchors}

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the pilot's weights, or the name that its owner gave it."""
        return self._agent_id or self._pilot.fingerprint

    def tracks(self, mu: Mu) -> Tracks:
        """The tracks of mu, (n, d)."""
        return Tracks(self.template.displaced(mu))

    def races(self, mu: Mu, seeds: Sequence[int]) -> Races:
        """Drones at the starts of the tracks of mu, n of them; close them after use."""
        return Races(set_off(self.tracks(mu), seeds))

    def fly(self, races: Races, watch: Callable[[Races], None] | None = None) -> None:
        """Let the pilot fly all races to their ends; `watch` looks on before every decision."""
        _fly(self._pilot, races, watch)

    def reference_score(
        self, mu: npt.ArrayLike, seeds: Sequence[int] | None = None
    ) -> npt.NDArray[np.float64]:
        """What the privileged pilot scores: who fails where it passes is to blame, not the track.

        Args:
            mu: (n, d), values in [-1, 1].
            seeds: n seeds; 0 for all by default.

        Returns:
            (n,) Q of the guidance told the gates' true poses.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        batch = self.parameters.validate(mu)
        checked = [0] * len(batch) if seeds is None else validate_seeds(seeds, len(batch))
        scores = np.empty(len(batch))
        for rows, races in self._batches(batch, checked):
            _fly(Reference(), races)
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
        """What the camera sees where the pilot first misses, beside a map of the race."""
        from sada_gym.envs.uav.pictures import Film

        return Film.of(self, mu, seed).summary()

    def view(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """What the camera sees at the start."""
        from sada_gym.envs.uav.pictures import view

        row, seed = validate_world(self.parameters, mu, seed)
        (start,) = set_off(self.tracks(row), [seed])
        return view(start, start.state)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """The whole race: what the camera sees, beside a map."""
        from sada_gym.envs.uav.pictures import Film

        film = Film.of(self, mu, seed)
        return film.frames(), film.score


def _fly(by: Pilot, races: Races, watch: Callable[[Races], None] | None = None) -> None:
    by.start(len(races))
    while len(which := races.under_way()):
        if watch is not None:
            watch(races)
        races.step(which, by.act(races, which))
