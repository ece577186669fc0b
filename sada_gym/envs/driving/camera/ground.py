"""The ground of a town as a picture from above: asphalt, markings, kerbs, pavements, grass.

It is painted from the lanes, without outside material. Colours are linear albedos, kept as their
square roots in bytes, which spends the bytes where the eye does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, LineType
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter

from sada_gym.envs.driving.world.town import LANE_WIDTH_M, Town, local_coordinates
from sada_gym.envs.pixels import Triple
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Integers

TEXEL_M = 0.15
LEVELS = 7
"""The number of levels of the mip map. Each level halves the resolution of the one before."""
SHADE_LEVEL = 2
"""The level at whose resolution shadows are kept."""
SHADE_TEXEL_M = TEXEL_M * 2**SHADE_LEVEL

_MARGIN_M = 45.0
_SHOULDER_M = 0.35
_KERB_M = 0.3
_PAVEMENT_M = 2.4

_ASPHALT = (0.072, 0.073, 0.078)
_WHITE = (0.62, 0.62, 0.60)
_YELLOW = (0.62, 0.42, 0.06)
_KERB = (0.30, 0.30, 0.29)
_PAVEMENT = (0.21, 0.195, 0.175)
_GRASS = (0.075, 0.135, 0.035)
_DRY_GRASS = (0.17, 0.15, 0.06)


class Ground(NamedTuple):
    """A mip-mapped picture of the ground."""

    # all levels behind one another, (k, 4) uint8: square roots of red, green and blue albedo, and
    # how much water the place holds in the wet, from 0 to 255
    texels: Bytes
    offset: Integers  # (levels,) where each level begins in `texels`
    shape: Integers  # (levels, 2) rows and columns of each
    origin: Floats  # (2,) world coordinates of the first texel's outer corner, in m
    texel_m: float  # the side of the finest level's texels
    kerb_distance: Floats32  # (rows, columns) of the finest level, distance from the asphalt in m


def paint(town: Town) -> Ground:
    """Paint the ground of a town."""
    canvas = _Canvas(town)
    lanes = town.network.lanes_list()
    road = np.zeros(canvas.shape, dtype=np.bool_)
    for lane in lanes:
        half = LANE_WIDTH_M / 2 + _SHOULDER_M
        rows, columns, along, lateral = canvas.around(lane, half)
        inside = (np.abs(lateral) <= half) & (along >= -0.2) & (along <= lane.length + 0.2)
        road[rows, columns] |= inside
    outside = distance_transform_edt(~road).astype(np.float32) * TEXEL_M
    rng = np.random.default_rng(0)
    canvas.lay_surfaces(outside, rng)
    for lane in town.marked_lanes():
        _mark(canvas, lane, guide=False)
    for lane in town.guided_lanes():
        _mark(canvas, lane, guide=True)
    for (_, corner), lane in town.streets.items():
        if town.is_junction(corner):
            _mark_junction(canvas, lane)
    water = np.clip(1.0 - outside / 0.5, 0, 1) * _puddles(canvas.shape, rng)
    water = np.maximum(water, 0.35 * (outside < _KERB_M + _PAVEMENT_M))
    return _mipmapped(canvas, water.astype(np.float32), outside)


class _Canvas:
    """Albedo from above, with a window of it for each primitive."""

    def __init__(self, town: Town) -> None:
        corners = np.array(list(town.layout.corners.values()), float)
        self.origin = corners.min(axis=0) - _MARGIN_M
        extent = np.ceil((corners.max(axis=0) + _MARGIN_M - self.origin) / TEXEL_M)
        step = 2 ** (LEVELS - 1)  # so that each level halves evenly
        columns, rows = (int(-(-n // step) * step) for n in extent)
        self.shape = (rows, columns)
        self.albedo: Floats32 = np.zeros((rows, columns, 3), np.float32)

    def around(self, lane: AbstractLane, half_width: float) -> tuple[slice, slice, Floats, Floats]:
        path = np.array([lane.position(s, 0.0) for s in np.linspace(0, lane.length, 16)])
        low = np.floor((path.min(axis=0) - half_width - 1 - self.origin) / TEXEL_M).astype(int)
        high = np.ceil((path.max(axis=0) + half_width + 1 - self.origin) / TEXEL_M).astype(int)
        x = self.origin[0] + (np.arange(low[0], high[0]) + 0.5) * TEXEL_M
        y = self.origin[1] + (np.arange(low[1], high[1]) + 0.5) * TEXEL_M
        points = np.stack(np.meshgrid(x, y), axis=-1)
        along, lateral = local_coordinates(lane, points)
        return slice(low[1], high[1]), slice(low[0], high[0]), along, lateral

    def blend(self, rows: slice, columns: slice, colour: Triple, share: Floats32) -> None:
        _blend(self.albedo[rows, columns], colour, share)

    def lay_surfaces(self, outside: Floats32, rng: np.random.Generator) -> None:
        coarse = _noise(self.shape, 25.0, rng)
        fine = _noise(self.shape, 0.4, rng)
        patches = _noise(self.shape, 3.0, rng)
        dry = np.clip(0.5 * coarse * patches, 0, 0.5)
        shade = 1 + 0.3 * coarse + 0.3 * fine
        for channel, (fresh, old) in enumerate(zip(_GRASS, _DRY_GRASS, strict=True)):
            self.albedo[..., channel] = shade * (fresh + dry * (old - fresh))
        paved = np.flatnonzero(outside < _KERB_M + _PAVEMENT_M + TEXEL_M)
        texels, away = self.albedo.reshape(-1, 3)[paved], outside.ravel()[paved]
        _blend(texels, _PAVEMENT, _below(away, _KERB_M + _PAVEMENT_M))
        _blend(texels, _KERB, _below(away, _KERB_M))
        _blend(texels, _ASPHALT, _below(away, TEXEL_M / 2))
        worn = 1 + 0.1 * fine.ravel()[paved] + 0.13 * patches.ravel()[paved] * (away <= 0)
        self.albedo.reshape(-1, 3)[paved] = texels * worn[:, None]


def _mark(canvas: _Canvas, lane: AbstractLane, *, guide: bool) -> None:
    """Paint a lane's lines, as highway-env's line types say: the middle yellow, the edge white.

    Through a junction they guide: both are white, the dashes short.
    """
    rows, columns, along, lateral = canvas.around(lane, LANE_WIDTH_M)
    inside = (along >= 0) & (along <= lane.length)
    for side, kind in zip((-1, 1), lane.line_types, strict=True):
        if kind == LineType.NONE:
            continue
        white = guide or side > 0
        line = _stroke(lateral - side * LANE_WIDTH_M / 2, 0.09 if white else 0.08) * inside
        if kind == LineType.STRIPED and guide:
            line = line * _dashes(along, on=0.6, period=1.8)
        elif kind == LineType.STRIPED:
            near_end = np.minimum(along, lane.length - along) < 9.0  # solid before a junction
            line = line * np.maximum(_dashes(along, on=3.0, period=6.0), near_end)
        canvas.blend(rows, columns, _WHITE if white else _YELLOW, line.astype(np.float32))


def _mark_junction(canvas: _Canvas, lane: AbstractLane) -> None:
    rows, columns, along, lateral = canvas.around(lane, LANE_WIDTH_M + 2)
    left = along - lane.length
    across = np.abs(lateral + LANE_WIDTH_M / 2) < LANE_WIDTH_M  # both lanes of the street
    stripes = _dashes(lateral, on=0.5, period=1.0)
    crossing = stripes * across * (left > -3.2) * (left < -0.4)
    stop = (left > -4.7) & (left < -4.2) & (np.abs(lateral) < LANE_WIDTH_M / 2 - 0.15)
    canvas.blend(rows, columns, _WHITE, np.maximum(crossing, stop).astype(np.float32))


def _mipmapped(canvas: _Canvas, water: Floats32, outside: Floats32) -> Ground:
    level = np.concatenate([np.clip(canvas.albedo, 0, 1), water[..., None]], axis=-1)
    parts, shapes = [], []
    for i in range(LEVELS):
        if i > 0:
            rows = level[0::2] + level[1::2]
            level = 0.25 * (rows[:, 0::2] + rows[:, 1::2])
        encoded = 255 * level
        encoded[..., :3] = 255 * np.sqrt(level[..., :3])
        parts.append((encoded + 0.5).astype(np.uint8).reshape(-1, 4))
        shapes.append(level.shape[:2])
    sizes = [len(part) for part in parts]
    return Ground(
        texels=np.concatenate(parts),
        offset=np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64),
        shape=np.array(shapes, np.int64),
        origin=canvas.origin,
        texel_m=TEXEL_M,
        kerb_distance=outside,
    )


def _blend(texels: Floats32, colour: Triple, share: Floats32) -> None:
    for channel, value in enumerate(colour):
        layer = texels[..., channel]
        layer += share * (np.float32(value) - layer)


def _below(distance: Floats32, limit: float) -> Floats32:
    share: Floats32 = np.clip(0.5 + (limit - distance) / TEXEL_M, 0, 1).astype(np.float32)
    return share


def _stroke(distance: Floats, half_width: float) -> Floats:
    return np.clip(0.5 + (half_width - np.abs(distance)) / TEXEL_M, 0, 1)


def _dashes(along: Floats, *, on: float, period: float) -> Floats:
    phase = np.mod(along, period)
    return np.clip(0.5 + (np.minimum(phase, on - phase)) / TEXEL_M, 0, 1)


def _noise(shape: tuple[int, int], size_m: float, rng: np.random.Generator) -> Floats32:
    step = max(1, int(size_m / TEXEL_M / 2))
    coarse = rng.normal(size=(shape[0] // step + 2, shape[1] // step + 2)).astype(np.float32)
    smooth = gaussian_filter(coarse, 0.8)
    fine = Image.fromarray(smooth).resize(shape[::-1], Image.Resampling.BILINEAR)
    noise: Floats32 = np.clip(np.asarray(fine) / (2 * smooth.std()), -1, 1)
    return noise


def _puddles(shape: tuple[int, int], rng: np.random.Generator) -> Floats32:
    hollow = _noise(shape, 5.0, rng) + 0.5 * _noise(shape, 1.5, rng)
    standing: Floats32 = np.clip(2.2 * hollow - 0.5, 0, 1)
    return 0.35 + 0.65 * standing
