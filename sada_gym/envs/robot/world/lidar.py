"""The lidar, and what the robot makes of its last scans: the nearest return in each direction.

Its range and its 360° are those of TurtleBot3's LDS-01 (3.5 m); it has 72 rays, one each 5°.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats, Floats32
from sada_gym.foundations.compiled import kernel

RAYS = 72
RANGE_M = 3.5
SCANS = 4
"""The scans that are remembered."""
SECTORS = 36


@kernel
def distance(
    x: float, y: float, dx: float, dy: float, hall: Floats, racks: Floats, circles: Floats
) -> float:
    """Return how far a ray goes until it meets something, or `RANGE_M`.

    The ray starts at x, y in the direction of a unit vector, dx and dy. `hall` is (2,) width and
    height, `racks` (k, 4) x0, y0, x1, y1, `circles` (m, 3) x, y, radius; those of radius 0 are left
    out.
    """
    nearest = RANGE_M
    if abs(dx) > 1e-12:
        nearest = min(nearest, max(0.0, ((hall[0] if dx > 0 else 0.0) - x) / dx))
    if abs(dy) > 1e-12:
        nearest = min(nearest, max(0.0, ((hall[1] if dy > 0 else 0.0) - y) / dy))
    for k in range(len(racks)):
        enter, leave = 0.0, nearest
        for axis in range(2):
            at, go = (x, dx) if axis == 0 else (y, dy)
            low, high = racks[k, axis] - at, racks[k, axis + 2] - at
            if abs(go) < 1e-12:
                if low > 0.0 or high < 0.0:
                    leave = -1.0
            else:
                first, last = low / go, high / go
                if first > last:
                    first, last = last, first
                enter, leave = max(enter, first), min(leave, last)
        if enter <= leave:
            nearest = enter
    for k in range(len(circles)):
        radius = circles[k, 2]
        if radius <= 0.0:
            continue
        ox, oy = circles[k, 0] - x, circles[k, 1] - y
        along = ox * dx + oy * dy
        beside = ox * ox + oy * oy - along * along
        if along > 0.0 and beside < radius * radius:
            nearest = min(nearest, max(0.0, along - math.sqrt(radius * radius - beside)))
    return nearest


@kernel
def scan(
    poses: Floats,
    mounts: Floats,
    hall: Floats,
    racks: Floats,
    circles: Floats,
    noise_m: Floats,
    lost: Bools,
    points: Floats,
) -> None:
    """Scan around robots, and write down where in the hall each believes its returns to be.

    A robot knows its pose, and believes that its lidar sits in its middle and looks ahead.

    `poses` (n, 3) x, y, heading; `mounts` (n, 2) the lidar's angle in rad and its place in m, both
    to the left; `hall` (2,), `racks` (n, k, 4) and `circles` (n, m, 3) as `distance` has them;
    `noise_m` (n, RAYS) what is added to each range; `lost` (n, RAYS) the rays that return nothing;
    `points` (n, RAYS, 2) is filled, with NaN where a ray returned nothing.
    """
    for i in range(len(poses)):
        heading = poses[i, 2]
        x = poses[i, 0] - mounts[i, 1] * math.sin(heading)
        y = poses[i, 1] + mounts[i, 1] * math.cos(heading)
        for k in range(RAYS):
            believed = heading + 2 * math.pi * k / RAYS
            angle = believed + mounts[i, 0]
            range_m = distance(x, y, math.cos(angle), math.sin(angle), hall, racks[i], circles[i])
            points[i, k, 0] = points[i, k, 1] = math.nan
            if range_m < RANGE_M and not lost[i, k]:
                range_m = max(0.0, range_m + noise_m[i, k])
                points[i, k, 0] = poses[i, 0] + range_m * math.cos(believed)
                points[i, k, 1] = poses[i, 1] + range_m * math.sin(believed)


@kernel
def nearest(poses: Floats, points: Floats) -> Floats32:
    """Return how near the nearest of remembered returns is in each sector, (n, SECTORS).

    `poses` (n, 3) x, y, heading; `points` (n, SCANS, RAYS, 2) in the hall. Returns from 1 at the
    robot's middle to 0 at `RANGE_M` or where there is none; the middle of the first sector is
    ahead, the others follow to the left.
    """
    sectors = np.zeros((len(poses), SECTORS), np.float32)
    width = 2 * math.pi / SECTORS
    for i in range(len(poses)):
        for j in range(points.shape[1]):
            for k in range(points.shape[2]):
                dx, dy = points[i, j, k, 0] - poses[i, 0], points[i, j, k, 1] - poses[i, 1]
                near = 1.0 - math.sqrt(dx * dx + dy * dy) / RANGE_M
                if near > 0.0:  # false for NaN, too
                    angle = math.atan2(dy, dx) - poses[i, 2]
                    sector = math.floor(angle / width + 0.5) % SECTORS
                    if near > sectors[i, sector]:
                        sectors[i, sector] = near
    return sectors
