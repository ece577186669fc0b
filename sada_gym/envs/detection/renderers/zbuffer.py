"""The z-buffer: which face of a mesh each sample of a picture shows, and how far away it is.

Points are projected to homogeneous sample coordinates (u d, v d, d), where d is the depth along the
viewing axis. In these, the edges of a triangle and its inverse depth are linear in u and v, and no
triangle has to be clipped, even where it reaches behind the eye (Olano and Greer 1997). Triangles
compute a common edge by the same operations, so that no sample along it is missed or drawn twice.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sada_gym.compiled import inlined, uncounted
from sada_gym.envs.detection.renderers.gbuffer import KernelCamera
from sada_gym.envs.pixels import dot

NEAR = 0.05
"""What is nearer to the eye than this, along the viewing axis, is not drawn."""
PLANES = 10
"""The numbers kept of a face: coefficients of u, v and 1 for its first two barycentric coordinates,
each over the depth, and for the inverse depth; then 1, or -1 if it is seen from behind."""

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


@uncounted
def project(vertices: Singles, camera: KernelCamera, points: Floats) -> None:
    """Fill points (v, 3) with the sample coordinates of vertices (v, 3).

    Args:
        vertices: In the scene.
        camera: Whose picture it is.
        points: (u d, v d, d) of each.
    """
    scale = 1.0 / camera.step
    for i in range(vertices.shape[0]):
        p = (
            vertices[i, 0] - camera.eye[0],
            vertices[i, 1] - camera.eye[1],
            vertices[i, 2] - camera.eye[2],
        )
        depth = -dot(camera.back, p)
        points[i, 0] = scale * dot(camera.right, p) + camera.middle[0] * depth
        points[i, 1] = camera.middle[1] * depth - scale * dot(camera.up, p)
        points[i, 2] = depth
        points[i, 3], points[i, 4] = points[i, 0] / depth, points[i, 1] / depth


@uncounted
def window(points: Floats, samples: int) -> tuple[int, int, int, int]:
    """Find the samples that points (v, 3) can touch: first column and row, last ones + 1."""
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for i in range(points.shape[0]):
        depth = points[i, 2]
        if depth < NEAR:  # where it is in the picture says nothing
            return 0, 0, samples, samples
        u, v = points[i, 0] / depth, points[i, 1] / depth
        left, top, right, bottom = min(left, u), min(top, v), max(right, u), max(bottom, v)
    return (
        _from(left, 0, samples),
        _from(top, 0, samples),
        _from(right, 0, samples),
        _from(bottom, 0, samples),
    )


@uncounted
def rasterise(
    points: Floats,
    faces: Indices,
    double_sided: bool,
    corner: tuple[int, int],
    planes: Floats,
    nearest: Floats,
    shown: Indices,
) -> None:
    """Draw faces into a window of a picture.

    Args:
        points: (v, 3), see `project`.
        faces: (f, 3), counter-clockwise seen from outside.
        double_sided: Whether faces show from behind too.
        corner: The window's first column and row.
        planes: (f, PLANES), filled for the faces that are drawn.
        nearest: (h, w) inverse depth of the nearest surface, 0 at first.
        shown: (h, w) the face that is seen, filled where `nearest` grows.
    """
    height, width = nearest.shape
    left, above = corner
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        p = (points[a, 0], points[a, 1], points[a, 2])
        q = (points[b, 0], points[b, 1], points[b, 2])
        r = (points[c, 0], points[c, 1], points[c, 2])
        first, last = 0, height
        if min(p[2], q[2], r[2]) >= NEAR:
            u, v, w = points[a, 3], points[b, 3], points[c, 3]
            if _from(min(u, v, w), left, width) >= _from(max(u, v, w), left, width):
                continue
            u, v, w = points[a, 4], points[b, 4], points[c, 4]
            first, last = _from(min(u, v, w), above, height), _from(max(u, v, w), above, height)
            if first >= last:
                continue
        one, two, three = _cross(q, r), _cross(r, p), _cross(p, q)
        # positive for faces seen from outside, since rows run downwards
        volume = -dot(p, one)
        side = -1.0
        if double_sided and volume < 0.0:
            volume, side = -volume, 1.0
        if not 0.0 < volume < math.inf:  # seen from behind, without area, or not finite
            continue
        one, two, three = _times(one, side), _times(two, side), _times(three, side)
        plane, share = planes[f], 1.0 / volume
        for k in range(3):
            plane[k], plane[3 + k] = one[k] * share, two[k] * share
            plane[6 + k] = (one[k] + two[k] + three[k]) * share
        plane[9] = -side
        for j in range(first, last):
            v = above + j + 0.5
            low, high = _cut(one, v, -math.inf, math.inf)
            low, high = _cut(two, v, low, high)
            low, high = _cut(three, v, low, high)
            begin, end = _from(low, left, width), _from(high, left, width)
            rest = plane[7] * v + plane[8]
            for i in range(begin, end):
                inverse = plane[6] * (left + i + 0.5) + rest
                if nearest[j, i] < inverse <= 1.0 / NEAR:
                    nearest[j, i], shown[j, i] = inverse, f


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _times(a, share):
    return a[0] * share, a[1] * share, a[2] * share


@inlined
def _cut(edge, v, low, high):
    """Keep of a row's stretch low..high what lies inside an edge; a sample at low is inside."""
    rest = edge[1] * v + edge[2]
    if edge[0] > 0.0:
        return max(low, -rest / edge[0]), high
    if edge[0] < 0.0:
        return low, min(high, -rest / edge[0])
    if rest > 0.0 or (rest == 0.0 and edge[1] > 0.0):
        return low, high
    return math.inf, -math.inf


@inlined
def _from(place, start, count):
    """Give the first of `count` samples, of which one begins at `start`, that lies at or behind a place."""
    return int(math.ceil(min(max(place - start, 0.0), float(count)) - 0.5))
