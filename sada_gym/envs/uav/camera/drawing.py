"""Pixel kernels of the drone's camera: a field, a sky, and gates of four boxes each.

Ground and sky are found by a ray for each pixel; the field's texture is a mip map. The boxes' faces
are clipped at the near plane, projected, and filled line by line into a depth buffer of twice the
picture's resolution, since far bars are thinner than a pixel. Scalar loops compiled by numba
without fast-math, so that equal scenes give equal bytes whatever else is drawn.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.envs.pixels import Triple, dot, splitmix, uniform
from sada_gym.envs.uav.world.gates import BARS, DEPTH_M
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Integers
from sada_gym.foundations.compiled import inlined, kernel

FINER = 2
"""The number of samples of the depth buffer along either side of a pixel."""
NEAR_M = 0.05
FAR_M = 400.0
"""Everything that is farther is haze."""
LIMIT_M = 1e6
"""A camera that is farther off, or at no finite place, sees black."""
BLOCK_M = 0.5
"""The side of the gates' chequers."""

_AROUND_M = 3.0
"""No part of a gate is farther from its middle."""


_PAINT = np.array(
    [
        [235, 40, 20],  # the side from which a gate is flown through, chequered
        [255, 215, 60],
        [35, 60, 175],  # its back
        [25, 25, 60],
        [245, 120, 20],  # all other faces
        [245, 120, 20],
    ],
    float,
)


class Field(NamedTuple):
    """The surroundings of the gates."""

    # (m, 3) the levels of the ground's mip map, one after another, square and periodic
    texels: Bytes
    first: Integers  # (levels,) the index at which each begins
    size: int  # the number of texels of the finest level's side, a power of two
    scales: Floats  # (levels,) the number of texels in a metre
    clouds: Floats32  # (k, k) how white, in [0, 1], periodic, k a power of two
    hills: Floats32  # (k,) slopes of the horizon's hills, periodic


class View(NamedTuple):
    """A camera: its place, its axes in the world, and its light."""

    place: Triple
    ahead: Triple
    right: Triple
    down: Triple
    sun: Triple
    ambient: float
    direct: float
    warmth: float
    shift: Triple


@inlined
def _uniform(seed: np.uint64, number: int) -> float:
    return uniform(splitmix(seed * np.uint64(16) + np.uint64(number)))


@inlined
def _turned(q: Floats, x: float, y: float, z: float) -> Triple:
    tx = 2 * (q[1] * z - q[2] * y)
    ty = 2 * (q[2] * x - q[0] * z)
    tz = 2 * (q[0] * y - q[1] * x)
    return (
        x + q[3] * tx + q[1] * tz - q[2] * ty,
        y + q[3] * ty + q[2] * tx - q[0] * tz,
        z + q[3] * tz + q[0] * ty - q[1] * tx,
    )


@inlined
def _view(pose: Floats, mount: Floats, seed: np.uint64) -> View:
    tilt, forward, up = mount[0], mount[1], mount[2]
    q = pose[3:7]
    ahead = _turned(q, math.cos(tilt), 0.0, math.sin(tilt))
    right = _turned(q, 0.0, -1.0, 0.0)
    down = _turned(q, math.sin(tilt), 0.0, -math.cos(tilt))
    off = _turned(q, forward, 0.0, up)
    azimuth = 2 * math.pi * _uniform(seed, 0)
    elevation = math.radians(25 + 40 * _uniform(seed, 1))
    flat = math.cos(elevation)
    light = 0.9 + 0.2 * _uniform(seed, 2)
    contrast = 0.3 + 0.4 * _uniform(seed, 3)
    return View(
        (pose[0] + off[0], pose[1] + off[1], max(pose[2] + off[2], 0.02)),
        ahead,
        right,
        down,
        (flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)),
        light * (1 - contrast),
        light * contrast * 1.3,
        0.06 * (2 * _uniform(seed, 4) - 1),
        (1000 * _uniform(seed, 5), 1000 * _uniform(seed, 6), _uniform(seed, 7)),
    )


@inlined
def _byte(value: float) -> np.uint8:
    return np.uint8(min(max(value, 0.0), 255.0))


@kernel
def _background(picture: Bytes, view: View, pixel: float, field: Field) -> None:
    rows, columns = picture.shape[0], picture.shape[1]
    x, y, pz = view.place[0] + view.shift[0], view.place[1] + view.shift[1], view.place[2]
    size, clouds, hills, scales = field.size, field.clouds, field.hills, field.scales
    levels, size_of_clouds = len(field.first), len(clouds)
    unit = (pixel * scales[0]) ** 2
    zenith = (70.0, 125.0, 205.0)
    ground_light = view.ambient + view.direct * view.sun[2]
    haze = (196.0 + 200 * view.warmth, 208.0, 220.0 - 200 * view.warmth)
    for row in range(rows):
        b = pixel * (row + 0.5 - rows / 2)
        for column in range(columns):
            a = pixel * (column + 0.5 - columns / 2)
            dx = view.ahead[0] + a * view.right[0] + b * view.down[0]
            dy = view.ahead[1] + a * view.right[1] + b * view.down[1]
            dz = view.ahead[2] + a * view.right[2] + b * view.down[2]
            if -dz * FAR_M > pz:
                less = -1.0 / dz
                t = pz * less
                # the size of a pixel on the ground, seen slantwise, in texels, squared
                foot = t * t * unit * (1.0 + less)
                level = 0
                while foot > 1.5 and level < levels - 1:
                    foot *= 0.25
                    level += 1
                side = size >> level
                i = math.floor((x + t * dx) * scales[level]) & (side - 1)
                j = math.floor((y + t * dy) * scales[level]) & (side - 1)
                texel = field.first[level] + i * side + j
                far = min(t / FAR_M, 1.0)
                far = 0.75 * far * (2 - far)
                light = ground_light * (1 - far)
                for channel in range(3):
                    lit = light * field.texels[texel, channel] + far * haze[channel]
                    picture[row, column, channel] = _byte(lit)
                continue
            flat = math.sqrt(dx * dx + dy * dy)
            if dz < 0.15 * flat:
                # an angle's stand-in, from 0 to 4 around the horizon
                around = dy / (abs(dx) + abs(dy))
                around = 1 + around if dx > 0 else 3 - around
                place = int((around / 4 + view.shift[2]) * len(hills)) & (len(hills) - 1)
                if dz < hills[place] * flat:
                    for channel, dark in enumerate((40.0, 10.0, 30.0)):
                        picture[row, column, channel] = _byte(0.62 * haze[channel] - dark)
                    continue
            high = dz / (0.35 * flat + dz)
            over = 60.0 / (dz + 0.12 * flat)
            i = math.floor(over * dx + x) & (size_of_clouds - 1)
            j = math.floor(over * dy + y) & (size_of_clouds - 1)
            cloud = min(5 * high, 1.0) * clouds[i, j]
            for channel in range(3):
                sky = haze[channel] + high * (zenith[channel] - haze[channel])
                picture[row, column, channel] = _byte(sky + cloud * (246.0 - sky))


@kernel
def _fill(
    corners: Floats,
    count: int,
    plane: Triple,
    along: Triple,
    start: float,
    paint: int,
    light: Triple,
    grid: Triple,
    depth: Floats32,
    colours: Bytes,
    edges: Integers,
) -> None:
    """Fill a convex polygon, (count, 3) depth, right and down, with chequers.

    `plane` times (1, right / depth, down / depth) is 1 / depth; `along` times a point, less
    `start`, is the place along the chequers, which have the rows `paint` and `paint` + 1 of
    `_PAINT`. `grid` is the number of samples for a unit of right / depth, and the middle's row and
    column. `depth` holds 1 / depth; `edges` widens to the rows and columns written.
    """
    scale, middle_row, middle_column = grid
    rows, columns = depth.shape
    top, bottom = 1e30, -1e30
    for i in range(count):
        y = corners[i, 2] / corners[i, 0] * scale + middle_row
        top, bottom = min(top, y), max(bottom, y)
    first = math.ceil(max(top - 0.5, 0.0))
    last = math.ceil(min(bottom - 0.5, float(rows)))
    for row in range(first, last):
        y = row + 0.5
        left, right = 1e30, -1e30
        for i in range(count):
            k = i + 1 if i + 1 < count else 0
            y0 = corners[i, 2] / corners[i, 0] * scale + middle_row
            y1 = corners[k, 2] / corners[k, 0] * scale + middle_row
            if (y0 <= y) == (y1 <= y):
                continue
            x0 = corners[i, 1] / corners[i, 0] * scale + middle_column
            x1 = corners[k, 1] / corners[k, 0] * scale + middle_column
            x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
            left, right = min(left, x), max(right, x)
        begin = math.ceil(max(left - 0.5, 0.0))
        end = math.ceil(min(right - 0.5, float(columns)))
        if begin >= end:
            continue
        edges[0], edges[1] = min(edges[0], row), max(edges[1], row)
        edges[2], edges[3] = min(edges[2], begin), max(edges[3], end - 1)
        v = (y - middle_row) / scale
        for column in range(begin, end):
            u = (column + 0.5 - middle_column) / scale
            near = plane[0] + plane[1] * u + plane[2] * v
            if near <= depth[row, column]:
                continue
            depth[row, column] = near
            at = (along[0] + along[1] * u + along[2] * v) / near - start
            block = paint + (math.floor(at / BLOCK_M) & 1)
            for channel in range(3):
                colours[row, column, channel] = _byte(_PAINT[block, channel] * light[channel])


@kernel
def _clipped(corners: Floats, out: Floats) -> int:
    """Cut four corners, (4, 3), at the near plane; give the number that `out` (6, 3) then holds."""
    count = 0
    for i in range(4):
        k = (i + 1) & 3
        depth, next_depth = corners[i, 0] - NEAR_M, corners[k, 0] - NEAR_M
        if depth >= 0:
            for axis in range(3):
                out[count, axis] = corners[i, axis]
            count += 1
        if (depth >= 0) != (next_depth >= 0):
            share = depth / (depth - next_depth)
            for axis in range(3):
                out[count, axis] = corners[i, axis] + share * (corners[k, axis] - corners[i, axis])
            out[count, 0] = NEAR_M
            count += 1
    return count


@kernel
def _gate(
    gate: Floats,
    view: View,
    grid: Triple,
    depth: Floats32,
    colours: Bytes,
    edges: Integers,
    corners: Floats,
    cut: Floats,
) -> None:
    cos, sin = math.cos(gate[3]), math.sin(gate[3])
    rx, ry, rz = gate[0] - view.place[0], gate[1] - view.place[1], gate[2] - view.place[2]
    middle = (rx, ry, rz)
    o = (dot(middle, view.ahead), dot(middle, view.right), dot(middle, view.down))
    if o[0] < -_AROUND_M or o[0] > FAR_M:
        return
    wide, high = grid[2] / grid[0], grid[1] / grid[0]
    if abs(o[1]) > wide * o[0] + _AROUND_M * math.sqrt(1 + wide * wide):
        return
    if abs(o[2]) > high * o[0] + _AROUND_M * math.sqrt(1 + high * high):
        return
    axes = ((cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0))
    seen = (
        (dot(axes[0], view.ahead), dot(axes[0], view.right), dot(axes[0], view.down)),
        (dot(axes[1], view.ahead), dot(axes[1], view.right), dot(axes[1], view.down)),
        (view.ahead[2], view.right[2], view.down[2]),
    )
    eye = (-(rx * cos + ry * sin), rx * sin - ry * cos, -rz)
    for bar in range(len(BARS)):
        mid = (0.0, BARS[bar, 0], BARS[bar, 1])
        half = (DEPTH_M / 2, BARS[bar, 2], BARS[bar, 3])
        long = 2 if half[2] > half[1] else 1
        for axis in range(3):
            off = eye[axis] - mid[axis]
            if abs(off) <= half[axis]:
                continue
            sign = 1.0 if off > 0 else -1.0
            level = mid[axis] + sign * half[axis]
            b, c = (axis + 1) % 3, (axis + 2) % 3
            for k in range(4):
                sb = 1.0 if k in (1, 2) else -1.0
                sc = 1.0 if k in (2, 3) else -1.0
                ub, uc = mid[b] + sb * half[b], mid[c] + sc * half[c]
                for i in range(3):
                    corners[k, i] = o[i] + level * seen[axis][i] + ub * seen[b][i] + uc * seen[c][i]
            count = _clipped(corners, cut)
            if count < 3:
                continue
            n = seen[axis]
            away = dot(n, o) + level
            plane = (n[0] / away, n[1] / away, n[2] / away)
            facing = max(sign * dot(axes[axis], view.sun), 0.0)
            light = view.ambient + view.direct * (0.35 + 0.65 * facing)
            lit = (light * (1 + view.warmth), light, light * (1 - view.warmth))
            paint = 4 if axis != 0 else 0 if sign < 0 else 2
            start = dot(seen[long], o)
            _fill(cut, count, plane, seen[long], start, paint, lit, grid, depth, colours, edges)


@kernel
def draw_all(
    pictures: Bytes,
    gates: Floats,
    poses: Floats,
    seeds: npt.NDArray[np.uint64],
    mount: Floats,
    pixel: float,
    field: Field,
) -> None:
    """Draw n pictures (n, rows, columns, 3) of gates (n, g, 4) from poses (n, at least 7).

    The seeds fix the light and the field's place. `mount` is the tilt upwards in radians, and the
    way forward and up from the drone's middle in m; `pixel` is a pixel's side at a depth of one.
    """
    rows, columns = pictures.shape[1], pictures.shape[2]
    depth = np.zeros((FINER * rows, FINER * columns), np.float32)
    colours = np.zeros((FINER * rows, FINER * columns, 3), np.uint8)
    corners, cut = np.zeros((4, 3)), np.zeros((6, 3))
    edges = np.zeros(4, np.int64)
    grid = (FINER / pixel, FINER * rows / 2, FINER * columns / 2)
    for i in range(len(pictures)):
        picture = pictures[i]
        sound = True
        for k in range(7):
            sound = sound and abs(poses[i, k]) < LIMIT_M
        if not sound:
            picture[:] = 0
            continue
        view = _view(poses[i], mount, seeds[i])
        _background(picture, view, pixel, field)
        edges[0], edges[1], edges[2], edges[3] = FINER * rows, -1, FINER * columns, -1
        for k in range(gates.shape[1]):
            _gate(gates[i, k], view, grid, depth, colours, edges, corners, cut)
        for row in range(edges[0] // FINER, edges[1] // FINER + 1):
            for column in range(edges[2] // FINER, edges[3] // FINER + 1):
                hits, red, green, blue = 0, 0, 0, 0
                for a in range(FINER * row, FINER * row + FINER):
                    for b in range(FINER * column, FINER * column + FINER):
                        if depth[a, b] > 0:
                            hits += 1
                            red += colours[a, b, 0]
                            green += colours[a, b, 1]
                            blue += colours[a, b, 2]
                            depth[a, b] = 0
                if hits:
                    bare = FINER * FINER - hits
                    dot = picture[row, column]
                    dot[0] = (red + bare * dot[0]) // (FINER * FINER)
                    dot[1] = (green + bare * dot[1]) // (FINER * FINER)
                    dot[2] = (blue + bare * dot[2]) // (FINER * FINER)
