"""The drone's own frame, in which the perception network is given motion and answers waypoints."""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.uav.world.drone import rotation
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.compiled import kernel

UNIT_M_S, UNIT_RAD_S = 10.0, 5.0
"""The speed and the turning rate that the network is given as 1."""
REACH_M = 10.0
"""The unit of the network's waypoints."""


def motion(poses: Floats) -> Floats32:
    """Return motion (n, 9) in drones' own frame: up, velocity in 10 m/s, turning in 5 rad/s.

    Poses (n, 13) are position, quaternion x, y, z, w, velocity and angular velocity.
    """
    motions = np.empty((len(poses), 9), np.float32)
    _to_motion(poses, motions)
    return motions


def in_level(poses: Floats, answers: Floats32) -> Floats:
    """Turn the network's answers (n, 6) into waypoints (n, 4) as `guidance` has them."""
    waypoints = np.empty((len(poses), 4))
    _to_level(poses, answers.astype(np.float64), waypoints)
    return waypoints


@kernel
def axes_of(q: Floats) -> Floats:
    """Return the drone's axes in the world, one a row, of a quaternion x, y, z, w."""
    return rotation(q[0], q[1], q[2], q[3]).T


@kernel
def along(axes: Floats, k: int, x: float, y: float, z: float) -> float:
    """Return the part of a vector along one of the axes."""
    part: float = axes[k, 0] * x + axes[k, 1] * y + axes[k, 2] * z
    return part


@kernel
def _to_motion(poses: Floats, motions: Floats32) -> None:
    for i in range(len(poses)):
        axes = axes_of(poses[i, 3:7])
        speed, turn = poses[i, 7:10], poses[i, 10:13]
        for k in range(3):
            motions[i, k] = axes[k, 2]
            motions[i, 3 + k] = along(axes, k, speed[0], speed[1], speed[2]) / UNIT_M_S
            motions[i, 6 + k] = along(axes, k, turn[0], turn[1], turn[2]) / UNIT_RAD_S


@kernel
def level_axes(axes: Floats) -> None:
    """Replace the drone's axes by those of the level frame, x to the drone's heading."""
    size = math.hypot(axes[0, 0], axes[0, 1])
    cos, sin = (axes[0, 0] / size, axes[0, 1] / size) if size > 0 else (1.0, 0.0)
    axes[0], axes[1], axes[2] = (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)


@kernel
def _to_level(poses: Floats, answers: Floats, waypoints: Floats) -> None:
    level = np.empty((3, 3))
    for i in range(len(poses)):
        own = axes_of(poses[i, 3:7])
        level[:] = own
        level_axes(level)
        x, y = 0.0, 0.0
        waypoints[i] = 0.0
        for k in range(3):
            for m in range(3):
                part = along(level, m, own[k, 0], own[k, 1], own[k, 2])
                waypoints[i, m] += REACH_M * part * answers[i, k]
                x += part * answers[i, 3 + k] if m == 0 else 0.0
                y += part * answers[i, 3 + k] if m == 1 else 0.0
        waypoints[i, 3] = math.atan2(y, x)
