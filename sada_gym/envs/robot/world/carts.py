"""Carts that drive to and fro on their lanes, and wait for the robot."""

from __future__ import annotations

import math

import numpy as np

from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel

SPEED_M_S = 0.25
SEES_M = 0.9
"""A cart stands still while the robot's middle is nearer to its own than this."""


@kernel
def places_of(lanes: Floats, carts: Floats) -> Floats:
    """Return where carts are, (n, c, 2): lanes (n, c, 4), carts (n, c, 2), see `drive`."""
    places = np.empty(carts.shape)
    for i in range(carts.shape[0]):
        for k in range(carts.shape[1]):
            for axis in range(2):
                start = lanes[i, k, axis]
                places[i, k, axis] = start + carts[i, k, 0] * (lanes[i, k, axis + 2] - start)
    return places


@kernel
def drive(poses: Floats, lanes: Floats, carts: Floats, step_s: float, steps: int) -> Floats:
    """Move carts along their lanes and back; return their velocities, (n, c, 2).

    `poses` (n, 3) of the robots; `lanes` (n, c, 4) x0, y0, x1, y1, without length where there is no
    cart; `carts` (n, c, 2) each cart's share of its lane, from 0 to 1, and its direction, 1 or -1,
    changed in place; `step_s` the time of each of `steps`.
    """
    velocities = np.zeros(carts.shape)
    places = places_of(lanes, carts)
    for i in range(carts.shape[0]):
        for k in range(carts.shape[1]):
            dx, dy = lanes[i, k, 2] - lanes[i, k, 0], lanes[i, k, 3] - lanes[i, k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            x, y = places[i, k, 0] - poses[i, 0], places[i, k, 1] - poses[i, 1]
            if length > 0.0 and x * x + y * y >= SEES_M * SEES_M:
                speed = carts[i, k, 1] * SPEED_M_S
                pace = speed / length
                velocities[i, k, 0], velocities[i, k, 1] = pace * dx, pace * dy
                carts[i, k, 0] += speed * step_s * steps / length
            if carts[i, k, 0] >= 1.0:
                carts[i, k, 1] = -1.0
            elif carts[i, k, 0] <= 0.0:
                carts[i, k, 1] = 1.0
    return velocities
