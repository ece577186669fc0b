"""Plane polygons: triangulation by ear clipping, and offsetting their outline inwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[np.float64]


def triangulate(ring: _Array) -> npt.NDArray[np.int64]:
    """Triangulates a nearly planar ring by clipping ears.

    Args:
        ring: (n, 3) points of a simple polygon, concave allowed, not repeating the first.

    Returns:
        (n - 2, 3) indices into the ring, in the ring's sense; fewer where it is degenerate.
    """
    points = _flattened(ring)
    after = np.roll(points, -1, axis=0)
    if (_cross(points - np.roll(points, 1, axis=0), after - points) > 0).all():
        tips = np.arange(1, len(points) - 1)
        return np.column_stack([np.zeros_like(tips), tips, tips + 1])
    left = list(range(len(points)))
    faces: list[tuple[int, int, int]] = []
    while len(left) > 3:
        tip = _ear(points, left)
        faces.append((left[tip - 1], left[tip], left[(tip + 1) % len(left)]))
        del left[tip]
    faces.append((left[0], left[1], left[2]))
    return np.array(faces, np.int64)


def offset_inwards(outline: _Array, distance: float) -> _Array:
    """Moves every edge of a simple polygon (n, 2) inwards by a distance small beside its edges."""
    turn = np.sign(_doubled_area(outline))
    edges = np.roll(outline, -1, axis=0) - outline
    edges /= np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
    inward = turn * np.column_stack([-edges[:, 1], edges[:, 0]])
    before = np.roll(inward, 1, axis=0)
    mitre = inward + before
    # A mitre is 1 / cos(half the turn) long; sharp corners end at three times the distance.
    length = np.maximum((mitre * inward).sum(axis=1, keepdims=True), 1 / 3)
    return np.asarray(outline + distance * mitre / length)


def _flattened(ring: _Array) -> _Array:
    """Projects along the axis of the ring's largest area, to a counter-clockwise polygon (n, 2)."""
    centred = ring - ring.mean(axis=0)
    area = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    axis = int(np.argmax(np.abs(area)))
    plane = centred[:, [(axis + 1) % 3, (axis + 2) % 3]]
    return np.asarray(plane if area[axis] >= 0 else plane * np.array([-1.0, 1.0]))


def _ear(points: _Array, left: list[int]) -> int:
    """Finds the position in `left` of a convex corner whose triangle holds no other corner.

    Of all such corners it takes the best shaped, so that few slivers arise.
    """
    corners = points[left]
    before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    area = _cross(corners - before, after - corners)
    size = ((after - before) ** 2).sum(axis=1) + ((after - corners) ** 2).sum(axis=1)
    size += ((corners - before) ** 2).sum(axis=1)
    quality = area / np.maximum(size, 1e-12)
    for tip in np.argsort(-quality, kind="stable"):
        if quality[tip] <= 0:
            break
        a, b, c = before[tip], corners[tip], after[tip]
        inside = _cross(b - a, corners - a) > -1e-12
        inside &= _cross(c - b, corners - b) > -1e-12
        inside &= _cross(a - c, corners - c) > -1e-12
        same = np.stack([np.abs(corners - p).max(axis=1) < 1e-9 for p in (a, b, c)]).any(axis=0)
        if not (inside & ~same).any():
            return int(tip)
    return int(np.argmax(quality))


def _cross(a: _Array, b: _Array) -> _Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _doubled_area(outline: _Array) -> float:
    return float(_cross(outline, np.roll(outline, -1, axis=0)).sum())
