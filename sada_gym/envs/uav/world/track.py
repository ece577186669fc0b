"""Tracks: from anchor points to gates, and the undisturbed templates that mu changes.

A track is a closed quadratic B-spline with gates at equal arc length. Every template is a regular
course of 80 m, flown anticlockwise. Where anchors come to lie so that two frames would touch or
nearly so, they are drawn back towards the template, all by one share, until they do not: every mu
gives a track that can be built. The range is the widest, in steps of half a metre, at which no more
than a twentieth of uniform mu are drawn back. No pilot was asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from sada_gym.envs.uav.world.gates import CENTRE_HEIGHT_M, DEPTH_M, OUTER_WIDTH_M
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.compiled import kernel
from sada_gym.parameters import Parameter, ParameterSpace

GATES = 8
"""The number of gates of every track, of one lap."""
DEGREE = 2
_SAMPLES = 600
"""The number of chords by which a lap is measured."""
_SHARES = np.append(0.5, np.arange(GATES) + 1.0) / GATES
"""The shares of the lap at which the start and the gates stand."""


class Tracks:
    """The tracks of a batch of anchor points.

    A track is built by itself, from arrays of one size: it never depends on the others. Anchors are
    (n, k, 2) in m, in the order of flight; k is at least 3.

    Attributes:
        gates: (n, GATES, 4) x, y, z of the opening's centre, and the heading of flight.
        starts: (n, 4) x, y, z and heading: half a gate's spacing before the first gate.
        length_m: (n,) the length of the lap.
        kept: (n,) the share of mu's displacements that a template kept: less than 1 where a track
            was drawn back.
    """

    def __init__(self, anchors: Floats) -> None:
        count = len(anchors)
        self.anchors = anchors
        self.gates = np.empty((count, GATES, 4))
        self.starts = np.empty((count, 4))
        self.length_m = np.empty(count)
        self.kept = np.ones(count)
        for i, points in enumerate(anchors):
            places, self.length_m[i] = along(points, _SHARES)
            self.starts[i], self.gates[i] = places[0], places[1:]

    def replace(self, i: int, other: Tracks, *, kept: float) -> None:
        """Lay the only track of another batch in place i."""
        self.anchors[i], self.kept[i] = other.anchors[0], kept
        self.gates[i], self.starts[i] = other.gates[0], other.starts[0]
        self.length_m[i] = other.length_m[0]

    def turns_deg(self) -> Floats:
        """Return the turns of tracks to each gate from the one before (or the start), (n, GATES).

        Left is positive. A loop between two gates counts: a turn may be of more than 180.
        """
        turned = np.empty((len(self.anchors), GATES))
        for i, points in enumerate(self.anchors):
            turned[i] = np.diff(_headings(points, _parameters(points, _SHARES)[0]))
        return np.rad2deg(turned)

    def sharpest_turn_deg(self) -> Floats:
        """Return the greatest turn of each track, to either side, (n,)."""
        sharpest: Floats = np.abs(self.turns_deg()).max(axis=1)
        return sharpest

    def closest_m(self) -> Floats:
        """Return the least distance between two frames of a track, (n,); 0 where they overlap."""
        return np.array([_closest(gates) for gates in self.gates])

    def start_m(self) -> Floats:
        """Return the distance from the start to the nearest frame, (n,)."""
        return np.array(
            [_nearest(gates, start) for gates, start in zip(self.gates, self.starts, strict=True)]
        )


def line(anchors: Floats, count: int = 200) -> Floats:
    """Return the lap of one track, (count, 2) points from the start on."""
    return along(anchors, np.linspace(0, 1, count))[0][:, :2]


def along(anchors: Floats, share: Floats) -> tuple[Floats, float]:
    """Return places on one track.

    Takes anchors (k, 2) and shares (m,) of the lap, in [0, 1]. Returns (m, 4) x, y, z and heading
    there, and the lap's length in m.
    """
    at, length = _parameters(anchors, share)
    spline = _spline(anchors)
    place, tangent = spline(at), spline.derivative()(at)
    heading = np.arctan2(tangent[:, 1], tangent[:, 0])
    return np.column_stack([place, np.full(len(at), CENTRE_HEIGHT_M), heading]), length


def _parameters(anchors: Floats, share: Floats) -> tuple[Floats, float]:
    """Return the spline's parameters at shares of a lap, and the lap's length in m."""
    count = len(anchors)
    points = _basis(count) @ anchors[np.arange(count + DEGREE) % count]
    step = np.hypot(*np.diff(points, axis=0).T)
    travelled = np.append(0.0, np.cumsum(step))
    at = np.interp(share * travelled[-1], travelled, np.linspace(0, count, _SAMPLES + 1))
    return at, float(travelled[-1])


def _headings(anchors: Floats, at: Floats) -> Floats:
    """Return headings at increasing parameters, without jumps of a whole turn."""
    # between two knots the tangent runs straight from one vector to another: less than half a turn
    every = np.union1d(at, np.arange(len(anchors) + 1))
    tangent = _spline(anchors).derivative()(every)
    headings: Floats = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    return headings[np.searchsorted(every, at)]


def _spline(anchors: Floats) -> BSpline:
    count = len(anchors)
    return BSpline(_knots(count), anchors[np.arange(count + DEGREE) % count], DEGREE)


def _knots(count: int) -> Floats:
    """Return uniform knots, so that the lap's parameter runs from 0 to the number of anchors."""
    return np.arange(-DEGREE, count + DEGREE + 1, dtype=np.float64)


@lru_cache
def _basis(count: int) -> Floats:
    parameter = np.linspace(0, count, _SAMPLES + 1)
    basis: Floats = BSpline.design_matrix(parameter, _knots(count), DEGREE).toarray()
    return basis


@kernel
def _corners(gate: Floats) -> Floats:
    cosine, sine = math.cos(gate[3]), math.sin(gate[3])
    corners = np.empty((4, 2))
    for k in range(4):
        x = DEPTH_M / 2 if k in (0, 3) else -DEPTH_M / 2
        y = OUTER_WIDTH_M / 2 if k < 2 else -OUTER_WIDTH_M / 2
        corners[k, 0] = gate[0] + x * cosine - y * sine
        corners[k, 1] = gate[1] + x * sine + y * cosine
    return corners


@kernel
def to_frame(gate: Floats, x: float, y: float) -> float:
    """Return the distance of a point from a frame, seen from above; 0 inside of it."""
    cosine, sine = math.cos(gate[3]), math.sin(gate[3])
    dx, dy = x - gate[0], y - gate[1]
    forward = max(abs(dx * cosine + dy * sine) - DEPTH_M / 2, 0.0)
    side = max(abs(-dx * sine + dy * cosine) - OUTER_WIDTH_M / 2, 0.0)
    return math.hypot(forward, side)


@kernel
def _cross(gate: Floats, other: Floats) -> bool:
    ax, ay = -math.sin(gate[3]), math.cos(gate[3])
    bx, by = -math.sin(other[3]), math.cos(other[3])
    dx, dy = other[0] - gate[0], other[1] - gate[1]
    across = ax * by - ay * bx
    if abs(across) < 1e-12:
        return False
    half = OUTER_WIDTH_M / 2
    along_one, along_other = (dx * by - dy * bx) / across, (dx * ay - dy * ax) / across
    crosses: bool = max(abs(along_one), abs(along_other)) <= half
    return crosses


@kernel
def _closest(gates: Floats) -> float:
    distance = math.inf
    for i in range(len(gates)):
        for j in range(i):
            dx, dy = gates[i, 0] - gates[j, 0], gates[i, 1] - gates[j, 1]
            if math.hypot(dx, dy) > OUTER_WIDTH_M + DEPTH_M + distance:
                continue
            if _cross(gates[i], gates[j]):
                return 0.0
            # two rectangles that do not cross are nearest at a corner of one of them
            for a, b in ((i, j), (j, i)):
                corners = _corners(gates[a])
                for k in range(4):
                    distance = min(distance, to_frame(gates[b], corners[k, 0], corners[k, 1]))
    return distance


@kernel
def _nearest(gates: Floats, place: Floats) -> float:
    distance = math.inf
    for i in range(len(gates)):
        distance = min(distance, to_frame(gates[i], place[0], place[1]))
    return distance


LEAST_SPACING_M = 0.9
"""The least distance between any two frames of a track."""
LEAST_START_M = 0.8
"""The least distance between the start and any frame."""

_KEPT_SHARES = np.linspace(0.95, 0.0, 20)


@dataclass(frozen=True)
class Template:
    """An undisturbed track."""

    anchors: tuple[tuple[float, float], ...]  # the anchor points in m, in the order of flight
    range_m: float  # the distance by which mu = 1 moves an anchor, along x and along y

    @property
    def parameters(self) -> ParameterSpace:
        """What mu controls: the anchors' displacements, x and y of the first one first."""
        return ParameterSpace(
            *(
                Parameter(f"anchor_{number}_{axis}_m", -self.range_m, self.range_m, "m")
                for number in range(1, len(self.anchors) + 1)
                for axis in "xy"
            )
        )

    def tracks(self, mu: npt.ArrayLike) -> Tracks:
        """Lay the tracks of a batch of mu (n, 2 k); those that cannot be built are drawn back."""
        rows = np.asarray(mu, np.float32).astype(np.float64)
        moves = self.range_m * rows.reshape(len(rows), len(self.anchors), 2)
        home = np.array(self.anchors)
        tracks = Tracks(home + moves)
        for i in np.flatnonzero(~buildable(tracks)).tolist():
            for share in _KEPT_SHARES.tolist():
                drawn_back = Tracks((home + share * moves[i])[None])
                if buildable(drawn_back)[0]:
                    tracks.replace(i, drawn_back, kept=share)
                    break
        return tracks


def buildable(tracks: Tracks) -> Bools:
    """Say whether all frames of tracks keep apart from one another and from the start, (n,)."""
    apart: Bools = tracks.closest_m() >= LEAST_SPACING_M
    apart &= tracks.start_m() >= LEAST_START_M
    return apart


TEMPLATES = {
    3: Template(((-19.3, -11.2), (19.3, -11.2), (0.0, 22.3)), 18.5),
    4: Template(((-13.4, -11.2), (13.4, -11.2), (13.4, 11.2), (-13.4, 11.2)), 15.0),
    5: Template(((-9.2, -12.6), (9.2, -12.6), (14.8, 4.8), (0.0, 15.6), (-14.8, 4.8)), 13.0),
}
"""The templates by the number of anchor points."""


def template(anchors: int) -> Template:
    """Return the template with this number of anchor points; raise `UserError` if none has it."""
    whole = isinstance(anchors, int | np.integer) and not isinstance(anchors, bool)
    if not whole or anchors not in TEMPLATES:
        raise UserError(
            f"Expected anchors among {', '.join(map(str, TEMPLATES))}, got {anchors!r}."
        )
    return TEMPLATES[anchors]
