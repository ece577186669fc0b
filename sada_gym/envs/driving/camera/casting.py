"""Walks over a grid: the upright objects that a horizontal ray meets, and what the sun reaches."""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.driving.camera.ground import SHADE_TEXEL_M
from sada_gym.envs.driving.camera.scenery import CELL_M, TownArrays
from sada_gym.foundations.arrays import Bytes, Floats
from sada_gym.foundations.compiled import kernel, uncounted

REACH_M = 160.0
"""Upright objects are seen up to this distance."""
MOST_HITS = 8


@uncounted
def cast(
    x: float, y: float, dx: float, dy: float, reach: float, town: TownArrays, hits: Floats
) -> int:
    """Find the upright objects that a horizontal ray meets, nearest first.

    `hits` (MOST_HITS, 4) takes for each: the distance, the object, where along a wall or how far
    beside a trunk it passes, and the angle's cosine between the wall's normal and north (x).
    Returns their number.
    """
    objects, first, items = town.scenery.objects, town.scenery.first, town.scenery.items
    rows, columns = town.scenery.cells[0], town.scenery.cells[1]
    left, top = town.scenery.origin[0], town.scenery.origin[1]
    px, py = (x - left) / CELL_M, (y - top) / CELL_M
    column, row = math.floor(px), math.floor(py)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    per_x = abs(1.0 / dx) if abs(dx) > 1e-12 else 1e30
    per_y = abs(1.0 / dy) if abs(dy) > 1e-12 else 1e30
    next_x = ((column + 1 - px) if dx > 0 else (px - column)) * per_x
    next_y = ((row + 1 - py) if dy > 0 else (py - row)) * per_y
    count, entered = 0, 0.0
    while entered * CELL_M < reach:
        if count == MOST_HITS and hits[count - 1, 0] < entered * CELL_M:
            break
        if 0 <= column < columns and 0 <= row < rows:
            at = row * columns + column
            for k in range(first[at], first[at + 1]):
                i = items[k]
                rx, ry = objects[i, 1] - x, objects[i, 2] - y
                distance, where, normal = -1.0, 0.0, 0.0
                if objects[i, 0] == 1.0:
                    where = rx * dy - ry * dx
                    if abs(where) < objects[i, 5]:
                        distance = rx * dx + ry * dy
                elif abs(rx * dy - ry * dx) < objects[i, 5] + objects[i, 6]:
                    ax, ay = objects[i, 3], objects[i, 4]
                    lx, ly = -(rx * ax + ry * ay), rx * ay - ry * ax
                    ldx, ldy = dx * ax + dy * ay, -dx * ay + dy * ax
                    half_l, half_w = objects[i, 5], objects[i, 6]
                    sx, sy = (1.0 if ldx > 0 else -1.0), (1.0 if ldy > 0 else -1.0)
                    in_x = (-sx * half_l - lx) / ldx if abs(ldx) > 1e-9 else -1e30
                    out_x = (sx * half_l - lx) / ldx if abs(ldx) > 1e-9 else 1e30
                    in_y = (-sy * half_w - ly) / ldy if abs(ldy) > 1e-9 else -1e30
                    out_y = (sy * half_w - ly) / ldy if abs(ldy) > 1e-9 else 1e30
                    if abs(ldx) <= 1e-9 and abs(lx) > half_l:
                        out_x = -1.0
                    if abs(ldy) <= 1e-9 and abs(ly) > half_w:
                        out_y = -1.0
                    near, far = max(in_x, in_y), min(out_x, out_y)
                    if near < far and near > 0.0:
                        distance = near
                        if in_x > in_y:
                            where = ly + near * ldy
                            normal = -sx  # along the axis
                        else:
                            where = lx + near * ldx
                            normal = -2.0 * sy  # across it
                if distance < 0.3 or distance > reach:
                    continue
                met = False
                for j in range(count):
                    met |= hits[j, 1] == i
                if met or (count == MOST_HITS and distance >= hits[count - 1, 0]):
                    continue
                j = min(count, MOST_HITS - 1)
                while j > 0 and hits[j - 1, 0] > distance:
                    for part in range(4):
                        hits[j, part] = hits[j - 1, part]
                    j -= 1
                hits[j, 0], hits[j, 1], hits[j, 2], hits[j, 3] = distance, i, where, normal
                count = min(count + 1, MOST_HITS)
        if next_x < next_y:
            entered = next_x
            next_x += per_x
            column += step_x
        else:
            entered = next_y
            next_y += per_y
            row += step_y
    return count


@kernel
def sunlit(shade: Bytes, sun_x: float, sun_y: float, sun_z: float, town: TownArrays) -> None:
    """Mark where the sun reaches the ground: 255, or 0 in a shadow."""
    flat = math.hypot(sun_x, sun_y)
    rise = sun_z / flat
    objects = town.scenery.objects
    hits = np.empty((MOST_HITS, 4))
    for row in range(shade.shape[0]):
        y = town.ground.origin[1] + (row + 0.5) * SHADE_TEXEL_M
        for column in range(shade.shape[1]):
            x = town.ground.origin[0] + (column + 0.5) * SHADE_TEXEL_M
            met = cast(x, y, sun_x / flat, sun_y / flat, 25.0 / rise, town, hits)
            light = 255
            for k in range(met):
                i = int(hits[k, 1])
                z = hits[k, 0] * rise
                if objects[i, 0] == 0.0:
                    if z < objects[i, 7]:
                        light = 0
                else:
                    tall = 1.25 * objects[i, 5]
                    up = (z - objects[i, 7] + tall) / tall
                    across = hits[k, 2] / objects[i, 5]
                    if across * across + up * up < 0.9:
                        light = min(light, 70)
            shade[row, column] = light
