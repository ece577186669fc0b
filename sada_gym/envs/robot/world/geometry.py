"""Compiled geometry of a hall: distances to what stands in it, and the shortest safe ways.

Everything that stands in a hall is a rectangle (a rack) or a circle (a pillar, a barrel, a cart),
and the hall itself is a rectangle from the origin.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from sada_gym.foundations.arrays import Floats, Integers
from sada_gym.foundations.compiled import kernel

CELL_M = 0.2
"""The size of the cells through which ways are sought."""
SPACING_M = 0.1
"""The distance between the points of a way."""


@kernel
def rectangle_distance(x: float, y: float, rectangle: Floats) -> float:
    """Return the distance of a point to a rectangle (4,): x0, y0, x1, y1; 0 inside."""
    dx = max(rectangle[0] - x, 0.0, x - rectangle[2])
    dy = max(rectangle[1] - y, 0.0, y - rectangle[3])
    return math.sqrt(dx * dx + dy * dy)


@kernel
def clearance(x: float, y: float, hall: Floats, racks: Floats, circles: Floats) -> float:
    """Return the distance of a point to the nearest surface, negative outside of the hall.

    `hall` is (2,) its width and height, `racks` (k, 4) x0, y0, x1, y1, `circles` (m, 3) x, y,
    radius.
    """
    distance: float = min(x, hall[0] - x, y, hall[1] - y)
    for k in range(len(racks)):
        distance = min(distance, rectangle_distance(x, y, racks[k]))
    for k in range(len(circles)):
        dx, dy = x - circles[k, 0], y - circles[k, 1]
        distance = min(distance, math.sqrt(dx * dx + dy * dy) - circles[k, 2])
    return distance


@kernel
def clearances(hall: Floats, racks: Floats, circles: Floats) -> Floats:
    """Return the clearance in the middle of each cell, (columns * rows,), row by row."""
    columns, rows = round(hall[0] / CELL_M), round(hall[1] / CELL_M)
    cells = np.empty(columns * rows)
    for cell in range(columns * rows):
        x, y = (cell % columns + 0.5) * CELL_M, (cell // columns + 0.5) * CELL_M
        cells[cell] = clearance(x, y, hall, racks, circles)
    return cells


@kernel
def spread_from(
    start: int, hall: Floats, cells: Floats, least_m: float, room_m: float
) -> tuple[Floats, Integers]:
    """Find the cheapest way from one cell to all others (Dijkstra).

    `hall` (2,) is its width and height, `cells` the clearance of each cell. No way leads through
    cells with less clearance than `least_m`; with less than `room_m` a metre costs up to twice
    more. Returns the cost of the way to each cell (inf where there is none), and the cell before.
    """
    columns = round(hall[0] / CELL_M)
    cost, before = np.full(len(cells), math.inf), np.full(len(cells), -1)
    cost[start] = 0.0
    heap = [(0.0, start)]
    while len(heap):
        cost_here, cell = heapq.heappop(heap)
        if cost_here > cost[cell]:
            continue
        column, row = cell % columns, cell // columns
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if not 0 <= column + dx < columns or (dx == 0 and dy == 0):
                    continue
                other = (row + dy) * columns + column + dx
                if not 0 <= other < len(cells) or cells[other] < least_m:
                    continue
                tight = max(0.0, 1.0 - cells[other] / room_m)
                new = cost_here + CELL_M * math.sqrt(dx * dx + dy * dy) * (1.0 + 2.0 * tight)
                if new < cost[other] - 1e-9:
                    cost[other], before[other] = new, cell
                    heapq.heappush(heap, (new, other))
    return cost, before


@kernel
def smooth_way(last: int, before: Integers, hall: Floats, racks: Floats, circles: Floats) -> Floats:
    """Return the way that ends in a cell as points (n, 2) at equal distances, with smooth bends."""
    columns = round(hall[0] / CELL_M)
    count, cell = 1, last
    while before[cell] >= 0:
        cell = before[cell]
        count += 1
    points = np.empty((count, 2))
    cell = last
    for k in range(count - 1, -1, -1):
        points[k, 0], points[k, 1] = (
            (cell % columns + 0.5) * CELL_M,
            (cell // columns + 0.5) * CELL_M,
        )
        cell = before[cell]
    points = _resampled(points)
    for _ in range(60):
        for k in range(1, len(points) - 1):
            x = (points[k - 1, 0] + points[k + 1, 0]) / 2
            y = (points[k - 1, 1] + points[k + 1, 1]) / 2
            room = clearance(x, y, hall, racks, circles)
            if room >= 0.5 or room >= clearance(points[k, 0], points[k, 1], hall, racks, circles):
                points[k, 0], points[k, 1] = x, y
    return _resampled(points)


@kernel
def _resampled(points: Floats) -> Floats:
    along = np.zeros(len(points))
    for k in range(1, len(points)):
        along[k] = along[k - 1] + math.sqrt(
            (points[k, 0] - points[k - 1, 0]) ** 2 + (points[k, 1] - points[k - 1, 1]) ** 2
        )
    count = max(2, round(along[-1] / SPACING_M) + 1)
    new = np.empty((count, 2))
    k = 0
    for i in range(count):
        at = along[-1] * i / (count - 1)
        while k < len(points) - 2 and along[k + 1] < at:
            k += 1
        step = along[k + 1] - along[k]
        share = (at - along[k]) / step if step > 0 else 0.0
        for axis in range(2):
            new[i, axis] = points[k, axis] + share * (points[k + 1, axis] - points[k, axis])
    return new
