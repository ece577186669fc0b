"""What stands along the streets: buildings and trees, placed by a fixed seed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sada_gym.envs.driving.camera.ground import Ground
from sada_gym.envs.driving.world.town import Town
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Integers

CELL_M = 8.0
"""The side of a cell of the grid in which a ray looks for objects."""

BUILDING, TREE = 0.0, 1.0

_PLOT_M = 0.5

_FACADES = (
    (0.42, 0.16, 0.10),
    (0.55, 0.45, 0.30),
    (0.34, 0.34, 0.36),
    (0.60, 0.56, 0.48),
    (0.48, 0.30, 0.18),
    (0.22, 0.28, 0.34),
    (0.62, 0.60, 0.57),
    (0.30, 0.24, 0.20),
)
_LEAVES = ((0.06, 0.16, 0.03), (0.09, 0.18, 0.04), (0.05, 0.12, 0.04), (0.13, 0.17, 0.04))


class Scenery(NamedTuple):
    """Upright objects and a grid that finds them."""

    # (n, 12): kind, centre x and y, axis x and y (unit), half length along the axis, half width
    # across it, height, red, green, blue, and a number in [0, 1) of its own. A tree's half length
    # is its crown's radius, its half width the trunk's.
    objects: Floats
    first: Integers  # (cells + 1,) where each cell's objects begin in `items`, row by row
    items: Integers  # indices into `objects`
    origin: Floats  # (2,) outer corner of the first cell, in m
    cells: Integers  # (2,) rows and columns


class TownArrays(NamedTuple):
    """A town for the kernels: clouds are periodic noise, tone maps light to bytes."""

    ground: Ground
    scenery: Scenery
    clouds: Floats32
    tone: Bytes


def furnish(town: Town, ground: Ground, *, seed: int = 0) -> Scenery:
    """Place buildings behind the pavements and trees on their edge."""
    rng = np.random.default_rng(seed)
    site = _Site(ground)
    for a, b in town.layout.streets:
        for lane in (town.streets[a, b], town.streets[b, a]):
            along = rng.uniform(0, 4)
            while along < lane.length:
                length, depth = rng.uniform(9, 19), rng.uniform(8, 13)
                setback = 1.75 + rng.uniform(6.0, 9.0)
                height = float(
                    rng.choice([7.0, 10.2, 13.4, 16.6, 19.8], p=[0.3, 0.3, 0.2, 0.1, 0.1])
                )
                colour = _FACADES[rng.integers(len(_FACADES))]
                centre = lane.position(along + length / 2, setback + depth / 2)
                if rng.random() < 0.8:
                    site.build(centre, lane.direction, length / 2, depth / 2, height, colour, rng)
                along += length + rng.choice([0.0, 1.0, 6.0], p=[0.4, 0.3, 0.3])
            for place in np.arange(rng.uniform(3, 9), lane.length, 11.0):
                if rng.random() < 0.6:
                    along = place + rng.uniform(-2, 2)
                    site.plant(lane.position(along, 1.75 + rng.uniform(3.4, 4.4)), rng)
    for _ in range(400):  # the greens between and around
        site.plant(site.anywhere(rng), rng, clear_m=9.0)
    return _indexed(np.array(site.objects), ground)


class _Site:
    """Keeps objects off the road and apart."""

    def __init__(self, ground: Ground) -> None:
        self._ground = ground
        self._extent = np.array(ground.kerb_distance.shape[::-1]) * ground.texel_m
        columns, rows = np.ceil(self._extent / _PLOT_M).astype(int)
        self._taken = np.zeros((rows, columns), dtype=np.bool_)
        self.objects: list[list[float]] = []

    def anywhere(self, rng: np.random.Generator) -> Floats:
        return self._ground.origin + self._extent * rng.uniform(0.02, 0.98, 2)

    def build(
        self,
        centre: Floats,
        axis: Floats,
        half_length: float,
        half_width: float,
        height: float,
        colour: tuple[float, float, float],
        rng: np.random.Generator,
    ) -> None:
        across = np.array([-axis[1], axis[0]])
        u, v = np.meshgrid(
            np.arange(-half_length, half_length, _PLOT_M),
            np.arange(-half_width, half_width, _PLOT_M),
        )
        footprint = centre + u.reshape(-1, 1) * axis + v.reshape(-1, 1) * across
        if self._claim(footprint, clear_m=3.5):
            shade = rng.uniform(0.8, 1.15)
            self.objects.append(
                [BUILDING, *centre, *axis, half_length, half_width, height]
                + [shade * c for c in colour]
                + [rng.random()]
            )

    def plant(self, centre: Floats, rng: np.random.Generator, *, clear_m: float = 0.9) -> None:
        radius = rng.uniform(1.5, 2.7)
        u, v = np.meshgrid(np.arange(-1, 1, _PLOT_M), np.arange(-1, 1, _PLOT_M))
        footprint = centre + np.stack([u.ravel(), v.ravel()], axis=-1)
        if self._claim(footprint, clear_m=clear_m):
            colour = _LEAVES[rng.integers(len(_LEAVES))]
            height = 3.0 * radius + rng.uniform(0.2, 1.2)
            self.objects.append(
                [TREE, *centre, 1.0, 0.0, radius, 0.16, height, *colour, rng.random()]
            )

    def _claim(self, points: Floats, *, clear_m: float) -> bool:
        """Take a place that is free and `clear_m` off the road; points stand `_PLOT_M` apart."""
        texels = ((points - self._ground.origin) / self._ground.texel_m).astype(int)
        columns, rows = texels[:, 0], texels[:, 1]
        distance = self._ground.kerb_distance
        height, width = len(distance), len(distance[0])
        if columns.min() < 0 or rows.min() < 0 or columns.max() >= width or rows.max() >= height:
            return False
        plots = ((points - self._ground.origin) / _PLOT_M).astype(int)
        if self._taken[plots[:, 1], plots[:, 0]].any() or distance[rows, columns].min() < clear_m:
            return False
        self._taken[plots[:, 1], plots[:, 0]] = True
        return True


def _indexed(objects: Floats, ground: Ground) -> Scenery:
    rows, columns = (math.ceil(size * ground.texel_m / CELL_M) for size in ground.shape[0])
    cells: list[list[int]] = [[] for _ in range(rows * columns)]
    for i, (kind, x, y, ax, ay, half_length, half_width, *_) in enumerate(objects):
        reach_x = half_length if kind == TREE else abs(ax) * half_length + abs(ay) * half_width
        reach_y = half_length if kind == TREE else abs(ay) * half_length + abs(ax) * half_width
        low = ((x - reach_x - ground.origin[0]) / CELL_M, (y - reach_y - ground.origin[1]) / CELL_M)
        high = (
            (x + reach_x - ground.origin[0]) / CELL_M,
            (y + reach_y - ground.origin[1]) / CELL_M,
        )
        for row in range(max(0, int(low[1])), min(rows - 1, int(high[1])) + 1):
            for column in range(max(0, int(low[0])), min(columns - 1, int(high[0])) + 1):
                cells[row * columns + column].append(i)
    counts = [len(items) for items in cells]
    return Scenery(
        objects=objects,
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        items=np.array([i for items in cells for i in items], np.int64),
        origin=ground.origin,
        cells=np.array([rows, columns], np.int64),
    )
