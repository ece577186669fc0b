"""Floor plans of a warehouse, drawn by a number: racks, pillars, barrels, carts, and five trips.

The robot's map holds the hall, its racks and its pillars, and each trip's way is planned on it.
Barrels and carts are not on the map. Every gap between two things is wide enough for the robot or
plainly shut, and nothing shuts an aisle, so that every trip can be made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sada_gym.envs.robot.world.geometry import (
    CELL_M,
    clearances,
    rectangle_distance,
    smooth_way,
    spread_from,
)
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel

HALL_M = (10.0, 8.0)
TRIPS = 5
BARRELS = 16
"""The greatest number of barrels."""
CARTS = 3
CART_RADIUS_M = 0.2

_RACK_DEPTH_M = 0.5
GAP_M = 0.85
"""A gap is at least as wide as this, or shut: less than `SHUT_M`."""
SHUT_M = 0.06
_TRIES = 40
_LEAST_M, _ROOM_M = 0.3, 0.65
"""The clearance that a planned way must have, and should have."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A floor plan."""

    number: int  # the number that it was drawn by
    racks: Floats  # (k, 4) rectangles x0, y0, x1, y1
    pillars: Floats  # (p, 3) circles x, y, radius
    barrels: Floats  # (b, 3) circles, at most `BARRELS`; a world has the first of them
    # (c, 4), at most `CARTS`: x0, y0, x1, y1; carts drive to and fro between these points
    lanes: Floats
    places: Floats  # (CARTS,) where on their lanes carts start, from 0 to 1
    ways: tuple[Floats, ...]  # the planned way of each trip, (n, 2) points about 0.1 m apart


@lru_cache(maxsize=4_096)
def floor_plan(number: int) -> FloorPlan:
    """Draw the floor plan of a number."""
    rng = np.random.default_rng(number)
    hall = np.array(HALL_M)
    racks = _draw_racks(rng)
    none = np.zeros((0, 4))
    pillars = _draw_round(rng, int(rng.integers(1, 5)), (0.12, 0.2), racks, np.zeros((0, 3)), none)
    lanes = _draw_lanes(rng, racks, pillars)
    barrels = _draw_round(rng, BARRELS, (0.18, 0.38), racks, pillars, lanes)
    cells = clearances(hall, racks, pillars)
    # trips start and end beside the lanes of carts, and away from all barrels that a world can have
    free = (cells >= 0.45) & (clearances(hall, racks, barrels) >= 0.5)
    columns = round(HALL_M[0] / CELL_M)
    middle = (np.arange(len(cells)) % columns + 0.5) * CELL_M
    height = (np.arange(len(cells)) // columns + 0.5) * CELL_M
    for x0, y0, x1, y1 in lanes:
        box = np.array([min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)])
        dx = np.maximum(np.maximum(box[0] - middle, middle - box[2]), 0.0)
        dy = np.maximum(np.maximum(box[1] - height, height - box[3]), 0.0)
        free &= np.hypot(dx, dy) >= CART_RADIUS_M + 0.5
    place = int(rng.choice(np.flatnonzero(free)))
    ways = []
    for _ in range(TRIPS):
        cost, before = spread_from(place, hall, cells, _LEAST_M, _ROOM_M)
        reached = free & np.isfinite(cost)
        far = np.flatnonzero(reached & (cost >= 3.5) & (cost <= 9.0))
        place = int(rng.choice(far if len(far) else np.flatnonzero(reached & (cost > 0.0))))
        ways.append(smooth_way(place, before, hall, racks, pillars))
    return FloorPlan(
        number, racks, pillars, barrels, lanes, rng.uniform(0.0, 1.0, CARTS), tuple(ways)
    )


def _draw_racks(rng: np.random.Generator) -> Floats:
    width, height = HALL_M
    racks = []
    aisle = (height - 3 * _RACK_DEPTH_M) / 4
    for row in range(3):
        y = aisle * (row + 1) + _RACK_DEPTH_M * row + rng.uniform(-0.15, 0.15)
        x, end = rng.uniform(1.4, 2.0), width - rng.uniform(1.4, 2.0)
        count = int(rng.integers(2, 4))
        passage = rng.uniform(1.2, 1.6, count - 1)
        shares = rng.dirichlet(np.full(count, 8.0)) * (end - x - passage.sum())
        for k in range(count):
            racks.append((x, y, x + shares[k], y + _RACK_DEPTH_M))
            x += shares[k] + (passage[k] if k < count - 1 else 0.0)
    return np.array(racks)


def _draw_lanes(rng: np.random.Generator, racks: Floats, pillars: Floats) -> Floats:
    """Draw the carts' lanes: each along one side of a rack, with room for the robot beside it."""
    lanes: list[tuple[float, float, float, float]] = []
    beside = CART_RADIUS_M + 0.04
    for _ in range(100):
        if len(lanes) == CARTS:
            break
        x0, y0, x1, y1 = racks[rng.integers(len(racks))]
        length = rng.uniform(0.7, 1.0) * (x1 - x0)
        start = x0 + rng.uniform(0.0, x1 - x0 - length)
        y = y0 - beside if rng.random() < 0.5 else y1 + beside
        lane = np.array([start, y, start + length, y])
        if length < 1.2:
            continue
        along_rack = rectangle_distance(start + length / 2, y, np.array([x0, y0, x1, y1]))
        others = [_from_lane(x, y, radius, lane) for x, y, radius in pillars.tolist()]
        others += [abs(y - other[1]) - CART_RADIUS_M for other in lanes if _overlap(lane, other)]
        if along_rack <= beside + 1e-9 and all(gap >= CART_RADIUS_M + GAP_M for gap in others):
            lanes.append((start, y, start + length, y))
    return np.array(lanes).reshape(-1, 4)


def _overlap(lane: Floats, other: tuple[float, float, float, float]) -> bool:
    return bool(lane[0] - 1.2 < other[2] and other[0] - 1.2 < lane[2])


def _from_lane(x: float, y: float, radius: float, lane: Floats) -> float:
    return float(rectangle_distance(x, y, lane)) - radius


def _draw_round(
    rng: np.random.Generator,
    count: int,
    radii: tuple[float, float],
    racks: Floats,
    pillars: Floats,
    lanes: Floats,
) -> Floats:
    """Draw pillars or barrels: they stand free, or against one rack or wall."""
    circles = np.zeros((count, 3))
    placed = 0
    for _ in range(_TRIES):
        if placed == count:
            break
        candidates = rng.random((256, 6))
        candidates[:, 2] = radii[0] + candidates[:, 2] * (radii[1] - radii[0])
        placed = _place(candidates, np.array(HALL_M), racks, pillars, lanes, circles, placed)
    return circles[:placed]


@kernel
def _place(
    candidates: Floats,
    hall: Floats,
    racks: Floats,
    pillars: Floats,
    lanes: Floats,
    circles: Floats,
    placed: int,
) -> int:
    """Keep those candidates whose gaps are wide enough or shut; return how many are placed now.

    A candidate, a row of (n, 6), is x, y, radius, and three numbers from 0 to 1: whether it stands
    at a rack, at which, and on which side. `circles` (m, 3) is filled from `placed` on.
    """
    for n in range(len(candidates)):
        if placed == len(circles):
            break
        radius = candidates[n, 2]
        x = radius + candidates[n, 0] * (hall[0] - 2 * radius)
        y = radius + candidates[n, 1] * (hall[1] - 2 * radius)
        if candidates[n, 3] < 0.7:
            rack = racks[int(candidates[n, 4] * len(racks))]
            x = rack[0] + candidates[n, 0] * (rack[2] - rack[0])
            aside = radius + 0.02
            y = rack[1] - aside if candidates[n, 5] < 0.5 else rack[3] + aside
        shut, fits = 0, True
        for k in range(4 + len(racks) + len(pillars) + placed + len(lanes)):
            i = k - 4
            if k < 2:
                gap = (x if k == 0 else hall[0] - x) - radius
            elif k < 4:
                gap = (y if k == 2 else hall[1] - y) - radius
            elif i < len(racks):
                gap = rectangle_distance(x, y, racks[i]) - radius
            elif i < len(racks) + len(pillars) + placed:
                i -= len(racks)
                other = pillars[i] if i < len(pillars) else circles[i - len(pillars)]
                gap = math.sqrt((x - other[0]) ** 2 + (y - other[1]) ** 2) - other[2] - radius
            else:
                i -= len(racks) + len(pillars) + placed
                gap = rectangle_distance(x, y, lanes[i]) - CART_RADIUS_M - radius
                fits = fits and gap >= GAP_M
            shut += gap < SHUT_M
            if gap < 0.0 or shut > 1 or SHUT_M <= gap < GAP_M:
                fits = False
            if not fits:
                break
        if fits:
            circles[placed, 0], circles[placed, 1], circles[placed, 2] = x, y, radius
            placed += 1
    return placed
