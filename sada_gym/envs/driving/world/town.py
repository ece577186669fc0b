"""Two towns: as planned, and as highway-env road networks.

Streets are two-way, and connectors lead through their corners. In highway-env's frame y points to
the right of x, so lateral offsets and steering are positive to the right. Traffic keeps right.

Both towns are our own. The drivers learn in `TRAINING`; the benchmark's routes lie in `BENCHMARK`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork
from highway_env.utils import wrap_to_pi

from sada_gym.errors import UserTypeError
from sada_gym.foundations.arrays import Floats

Corner = str


@dataclass(frozen=True)
class Layout:
    """The plan of a town."""

    name: str
    # the places where streets meet, (x, y) in m by name; y points to the right of x
    corners: Mapping[Corner, tuple[float, float]]
    streets: tuple[tuple[Corner, Corner], ...]  # pairs of corners that a two-way street joins

    def neighbours(self, corner: Corner) -> tuple[Corner, ...]:
        """Return the corners that a street joins to this one."""
        return tuple(b if a == corner else a for a, b in self.streets if corner in (a, b))


def _grid(name: str, rows: tuple[str, ...], absent: str, **corners: tuple[float, float]) -> Layout:
    columns = zip(*(row.split() for row in rows), strict=True)
    lines = [*(row.split() for row in rows), *columns]
    pairs = [(a, b) for line in lines for a, b in pairwise(line)]
    without = {tuple(pair.split("-")) for pair in absent.split()}
    streets = tuple(pair for pair in pairs if pair not in without)
    return Layout(name, MappingProxyType(corners), streets)


BENCHMARK = _grid(
    "benchmark",
    ("A0 B0 C0 D0 E0", "A1 B1 C1 D1 E1", "A2 B2 C2 D2 E2", "A3 B3 C3 D3 E3"),
    absent="C1-D1 B2-B3 D2-E2",
    A0=(0, 0), B0=(82, -6), C0=(166, 5), D0=(248, 0), E0=(334, 8),
    A1=(-5, 78), B1=(86, 71), C1=(160, 83), D1=(252, 75), E1=(328, 82),
    A2=(6, 158), B2=(78, 163), C2=(170, 155), D2=(244, 166), E2=(338, 156),
    A3=(0, 240), B3=(88, 233), C3=(162, 242), D3=(254, 235), E3=(330, 244),
)  # fmt: skip

TRAINING = _grid(
    "training",
    ("A0 B0 C0 D0 E0", "A1 B1 C1 D1 E1", "A2 B2 C2 D2 E2", "A3 B3 C3 D3 E3", "A4 B4 C4 D4 E4"),
    absent="B0-C0 A2-B2 C1-C2 D2-D3 D3-E3 B3-B4 D0-D1",
    A0=(0, 0), B0=(70, 8), C0=(150, -6), D0=(242, 2), E0=(312, -4),
    A1=(-6, 66), B1=(78, 74), C1=(164, 64), D1=(234, 78), E1=(322, 70),
    A2=(8, 152), B2=(72, 140), C2=(156, 156), D2=(248, 146), E2=(316, 158),
    A3=(-4, 222), B3=(84, 230), C3=(150, 220), D3=(238, 234), E3=(326, 224),
    A4=(2, 310), B4=(74, 300), C4=(166, 314), D4=(244, 302), E4=(318, 312),
)  # fmt: skip

LAYOUTS = {layout.name: layout for layout in (BENCHMARK, TRAINING)}


LANE_WIDTH_M = 3.5
JUNCTION_SETBACK_M = 12.0
"""Where three or four streets meet, their lanes end so far from the corner."""
BEND_SETBACK_M = 22.0
"""Where a street only turns, its lanes end so far from the corner."""

_STRAIGHT_BELOW = np.deg2rad(30.0)

Manoeuvre = Literal["follow", "left", "right", "straight"]


@dataclass(frozen=True)
class Passage:
    """The way through a corner."""

    manoeuvre: Manoeuvre  # the driver's command there; `follow` where there is no choice
    lanes: tuple[AbstractLane, ...]  # one to three lanes, end to end


class Town:
    """A layout with its lanes.

    Attributes:
        layout: The plan.
        network: All lanes, for highway-env.
        streets: The lane from one corner towards the next, by both corners' names.
        passages: The way through a corner, by the corners before, at and after it.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.network = RoadNetwork()
        self.streets: dict[tuple[Corner, Corner], StraightLane] = {}
        self.passages: dict[tuple[Corner, Corner, Corner], Passage] = {}
        for a, b in layout.streets:
            for pair in ((a, b), (b, a)):
                self.streets[pair] = self._street(*pair)
                self.network.add_lane(*_ends(*pair), self.streets[pair])
        for corner in layout.corners:
            around = layout.neighbours(corner)
            for before in around:
                for after in around:
                    if before != after:
                        self._add_passage(before, corner, after)

    def is_junction(self, corner: Corner) -> bool:
        """Say whether a driver has a choice there."""
        return len(self.layout.neighbours(corner)) > 2

    def marked_lanes(self) -> list[AbstractLane]:
        """Return the lanes with a middle and an edge line: those of streets and of bends."""
        bends = [p.lanes for p in self.passages.values() if p.manoeuvre == "follow"]
        return [*self.streets.values(), *(lane for lanes in bends for lane in lanes)]

    def guided_lanes(self) -> list[AbstractLane]:
        """Return the lanes through junctions."""
        ways = [p.lanes for p in self.passages.values() if p.manoeuvre != "follow"]
        return [lane for lanes in ways for lane in lanes]

    def _street(self, a: Corner, b: Corner) -> StraightLane:
        start, end = (np.array(self.layout.corners[corner], float) for corner in (a, b))
        along = (end - start) / np.linalg.norm(end - start)
        right = LANE_WIDTH_M / 2 * np.array([-along[1], along[0]])
        left_line = LineType.STRIPED if a < b else LineType.NONE  # one middle line, not two
        return StraightLane(
            start + self._setback(a) * along + right,
            end - self._setback(b) * along + right,
            width=LANE_WIDTH_M,
            line_types=(left_line, LineType.CONTINUOUS),
        )

    def _setback(self, corner: Corner) -> float:
        return JUNCTION_SETBACK_M if self.is_junction(corner) else BEND_SETBACK_M

    def _add_passage(self, before: Corner, corner: Corner, after: Corner) -> None:
        arriving, leaving = self.streets[before, corner], self.streets[corner, after]
        turn = wrap_to_pi(leaving.heading - arriving.heading)
        manoeuvre = self._manoeuvre(turn, corner)
        left_line, right_line = LineType.NONE, LineType.CONTINUOUS
        if manoeuvre == "left" or (manoeuvre == "follow" and before < after):
            left_line = LineType.STRIPED
        if manoeuvre == "left" or (manoeuvre == "straight" and self._opens_right(before, corner)):
            right_line = LineType.NONE
        lines = (left_line, right_line)
        lanes = _connect(arriving, leaving, lines)
        self.passages[before, corner, after] = Passage(manoeuvre, lanes)
        way = f"{before}>{corner}>{after}"
        nodes = [_ends(before, corner)[1], *(f"{way}/{i}" for i in range(1, len(lanes)))]
        for lane, start, end in zip(
            lanes, nodes, [*nodes[1:], _ends(corner, after)[0]], strict=True
        ):
            self.network.add_lane(start, end, lane)

    def _manoeuvre(self, turn: float, corner: Corner) -> Manoeuvre:
        if not self.is_junction(corner):
            return "follow"
        if abs(turn) < _STRAIGHT_BELOW:
            return "straight"
        return "right" if turn > 0 else "left"

    def _opens_right(self, before: Corner, corner: Corner) -> bool:
        arriving = self.streets[before, corner].heading
        ways = [self.streets[corner, c] for c in self.layout.neighbours(corner) if c != before]
        return any(wrap_to_pi(way.heading - arriving) > _STRAIGHT_BELOW for way in ways)


@cache
def town(layout_name: str) -> Town:
    """Build a town once a process: `benchmark` or `training`."""
    return Town(LAYOUTS[layout_name])


def local_coordinates(lane: AbstractLane, points: Floats) -> tuple[Floats, Floats]:
    """Return longitudinal and lateral lane coordinates of points (..., 2), as highway-env has them.

    Raise `UserTypeError` if the lane is neither straight nor circular.
    """
    if type(lane) is StraightLane:  # its subclasses bend
        delta = points - lane.start
        return delta @ lane.direction, delta @ lane.direction_lateral
    if type(lane) is CircularLane:
        delta = points - lane.center
        angle = np.arctan2(delta[..., 1], delta[..., 0]) - lane.start_phase
        angle = (angle + np.pi) % (2 * np.pi) - np.pi
        radius = np.hypot(delta[..., 0], delta[..., 1])
        return lane.direction * angle * lane.radius, lane.direction * (lane.radius - radius)
    raise UserTypeError(f"Expected a straight or circular lane, got {type(lane).__name__}.")


def _ends(a: Corner, b: Corner) -> tuple[str, str]:
    return f"{a}>{b}/start", f"{a}>{b}/end"


def _connect(
    arriving: StraightLane, leaving: StraightLane, lines: tuple[int, int]
) -> tuple[AbstractLane, ...]:
    """Join two lanes smoothly: an arc as wide as fits, and straight pieces for the rest."""
    start, end = arriving.end, leaving.start
    turn = wrap_to_pi(leaving.heading - arriving.heading)
    if abs(turn) < 1e-3:
        return (StraightLane(start, end, width=LANE_WIDTH_M, line_types=lines),)
    # start + before * arriving.direction = end - after * leaving.direction
    matrix = np.column_stack([arriving.direction, leaving.direction])
    before, after = np.linalg.solve(matrix, end - start)
    tangent = min(before, after)
    radius = tangent / np.tan(abs(turn) / 2)
    touch = start + (before - tangent) * arriving.direction
    side = np.sign(turn)
    centre = touch + side * radius * arriving.direction_lateral
    phase = arriving.heading - side * np.pi / 2
    arc = CircularLane(
        centre, radius, phase, phase + turn, turn > 0, width=LANE_WIDTH_M, line_types=lines
    )
    lanes: list[AbstractLane] = [arc]
    leave = arc.position(arc.length, 0)
    if before - tangent > 1e-3:
        lanes.insert(0, StraightLane(start, touch, width=LANE_WIDTH_M, line_types=lines))
    if after - tangent > 1e-3:
        lanes.append(StraightLane(leave, end, width=LANE_WIDTH_M, line_types=lines))
    return tuple(lanes)
