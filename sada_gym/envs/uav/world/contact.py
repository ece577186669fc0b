"""What a drone touches: its box against the bars of gates and the ground, by geometry."""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.uav.world.drone import rotation
from sada_gym.envs.uav.world.gates import BARS, DEPTH_M, OUTER_WIDTH_M
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel

BODY_M = (0.24, 0.20, 0.06)
"""The size of the drone's box: forward, to the left, up."""


_HALF = np.array(BODY_M) / 2
_RADIUS_M = math.sqrt(float((_HALF**2).sum()))
_FAR_M = math.hypot(OUTER_WIDTH_M / 2, DEPTH_M / 2) + _RADIUS_M
_ROUNDING = 1e-12
"""Added to each cosine between two boxes, since the cross product of parallel edges is no axis."""


@kernel
def touches(state: Floats, gates: Floats) -> bool:
    """Say whether a drone (13,) touches the ground or a frame of gates (g, 4)."""
    x, y, z = state[0], state[1], state[2]
    r = rotation(state[3], state[4], state[5], state[6])
    reach = 0.0
    for k in range(3):
        reach += abs(r[2, k]) * _HALF[k]
    if z <= reach:
        return True
    for g in range(len(gates)):
        dx, dy = x - gates[g, 0], y - gates[g, 1]
        if dx * dx + dy * dy > _FAR_M * _FAR_M:
            continue
        cosine, sine = math.cos(gates[g, 3]), math.sin(gates[g, 3])
        ahead, left, up = dx * cosine + dy * sine, dy * cosine - dx * sine, z - gates[g, 2]
        if abs(ahead) > DEPTH_M / 2 + _RADIUS_M:
            continue
        own = np.empty((3, 3))  # the drone's axes in the gate's frame
        for k in range(3):
            own[0, k] = r[0, k] * cosine + r[1, k] * sine
            own[1, k] = r[1, k] * cosine - r[0, k] * sine
            own[2, k] = r[2, k]
        for b in range(len(BARS)):
            if _meet(own, ahead, left - BARS[b, 0], up - BARS[b, 1], BARS[b, 2], BARS[b, 3]):
                return True
    return False


@kernel
def _meet(own: Floats, x: float, y: float, z: float, width: float, height: float) -> bool:
    """Say whether the drone's box and a bar have a point in common (separating axes, Gottschalk).

    The columns of `own` (3, 3) are the drone's axes in the bar's frame, and x, y, z its place from
    the bar's middle; `width` and `height` are half the bar's.
    """
    off, bar, size = np.array((x, y, z)), np.array((DEPTH_M / 2, width, height)), np.abs(own)
    size += _ROUNDING
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        if abs(off[i]) > bar[i] + (size[i] * _HALF).sum():
            return False
        if abs((off * own[:, i]).sum()) > _HALF[i] + (bar * size[:, i]).sum():
            return False
        for k in range(3):
            c, d = (k + 1) % 3, (k + 2) % 3
            reach = bar[a] * size[b, k] + bar[b] * size[a, k]
            reach += _HALF[c] * size[i, d] + _HALF[d] * size[i, c]
            if abs(off[b] * own[a, k] - off[a] * own[b, k]) > reach:
                return False
    return True
