"""How races begin: those of the benchmark at the start, those of training anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym.envs.checks import bounded, check_bounds
from sada_gym.envs.uav.episodes import RacingStart
from sada_gym.envs.uav.world.guidance import TOP_SPEED_M_S
from sada_gym.envs.uav.world.templates import TEMPLATES, template
from sada_gym.envs.uav.world.track import GATES, Tracks, along
from sada_gym.errors import UserError

START_SHIFT_M = 0.3
"""A seed moves the drone from the start by at most this, along x and along y."""
START_TURN_DEG = 5.0
"""A seed turns the drone by at most this."""


@dataclass(frozen=True)
class StartDistribution:
    """A distribution of races on tracks around the templates.

    A race may begin between any two gates; it is a lap all the same.

    Attributes:
        anchors: The numbers of anchor points that occur.
        spread: The greatest distance from 0 of each number of mu.
        shift_m: The greatest distance from the track's line, along x and along y.
        turned_deg: The greatest angle by which a drone is turned.
        speed_m_s: The greatest speed at which it starts, to where it heads.
    """

    anchors: tuple[int, ...] = tuple(TEMPLATES)
    spread: float = bounded(0.0, 1.0, 0.25)
    shift_m: float = bounded(0.0, 1.0, 0.5)
    turned_deg: float = bounded(0.0, 45.0, 15.0)
    speed_m_s: float = bounded(0.0, TOP_SPEED_M_S, 10.0)

    def __post_init__(self) -> None:
        """Reject unknown templates, and starts far off the track."""
        if not isinstance(self.anchors, tuple) or not self.anchors:
            raise UserError(
                f"Expected anchors to be a tuple of at least one number, got {self.anchors!r}."
            )
        for count in self.anchors:
            template(count)
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> RacingStart:
        """Draw one race."""
        chosen = template(int(self.anchors[rng.integers(len(self.anchors))]))
        mu = rng.uniform(-self.spread, self.spread, (1, len(chosen.parameters)))
        track = chosen.tracks(mu)
        anchors = track.anchors[0]
        first = int(rng.integers(GATES))
        (place,), _ = along(anchors, np.array([(first + 0.5) / GATES]))
        x, y = place[:2] + rng.uniform(-self.shift_m, self.shift_m, 2)
        turned = np.deg2rad(rng.uniform(-self.turned_deg, self.turned_deg))
        heading, speed = float(place[3] + turned), float(rng.uniform(0, self.speed_m_s))
        return RacingStart(
            gates=np.roll(track.gates[0], -first, axis=0),
            place=(float(x), float(y), float(place[2]), heading),
            seed=int(rng.integers(2**31)),
            velocity=(speed * float(np.cos(heading)), speed * float(np.sin(heading)), 0.0),
            anchors=anchors,
        )


def benchmark_starts(tracks: Tracks, seeds: Sequence[int]) -> list[RacingStart]:
    """Make the benchmark's starts on some tracks: at rest near the start, moved by the seeds."""
    starts = []
    laid = zip(tracks.gates, tracks.starts, tracks.anchors, seeds, strict=True)
    for gates, (x, y, z, heading), anchors, seed in laid:
        draw = np.random.default_rng(seed).uniform(-1, 1, 3).tolist()
        place = (
            float(x) + START_SHIFT_M * draw[0],
            float(y) + START_SHIFT_M * draw[1],
            float(z),
            float(heading) + float(np.deg2rad(START_TURN_DEG)) * draw[2],
        )
        starts.append(RacingStart(gates, place, seed, anchors=anchors))
    return starts
