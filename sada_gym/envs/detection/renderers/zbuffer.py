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

from sada_gym.envs.detection.renderers.gbuffer import KernelCamera, Skin
from sada_gym.envs.detection.renderers.texture import texel, uv_at
from sada_gym.envs.pixels import Triple, dot, scaled
from sada_gym.foundations.compiled import inlined, uncounted

NEAR = 0.05
"""What is nearer to the eye than this, along the viewing axis, is not drawn."""
COORDINATES = 5
"""The numbers kept of a projected point: u d, v d, d, u, v."""
PLANES = 10
"""The numbers kept of a face: coefficients of u, v and 1 for its first two barycentric coordinates,
each over the depth, and for the inverse depth; then 1, or -1 where it is seen from behind."""

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int32]


@uncounted
def project(vertices: Singles, camera: KernelCamera, points: Floats) -> None:
    """Fill points (v, COORDINATES) with where a camera sees vertices (v, 3)."""
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
def bounds(points: Floats, per_pixel: int, size: int) -> tuple[int, int, int, int]:
    """Find the pixels that points (v, COORDINATES) can touch: first column, row, last ones + 1.

    A pixel has `per_pixel` samples along each axis, the picture `size` pixels a side.
    """
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for i in range(points.shape[0]):
        if points[i, 2] < NEAR:  # its place in the picture says nothing
            return 0, 0, size, size
        left, right = min(left, points[i, 3]), max(right, points[i, 3])
        top, bottom = min(top, points[i, 4]), max(bottom, points[i, 4])
    if not (left <= right and top <= bottom):
        return 0, 0, 0, 0
    return (
        math.floor(min(max(left / per_pixel, 0.0), float(size))),
        math.floor(min(max(top / per_pixel, 0.0), float(size))),
        math.ceil(min(max(right / per_pixel, 0.0), float(size))),
        math.ceil(min(max(bottom / per_pixel, 0.0), float(size))),
    )


@uncounted
def rasterise(
    points: Floats,
    places: Indices,
    faces: Indices,
    double_sided: bool,
    corner: tuple[int, int],
    planes: Floats,
    nearest: Floats,
    shown: Indices,
    skin: Skin | None = None,
    part: tuple[int, int] = (0, 0),
) -> None:
    """Draw faces into a window of a picture.

    Without a skin the machine code knows nothing of textures.

    Args:
        points: (v, COORDINATES), see `project`.
        places: (v, 2), filled: each point's first column and row, see `_first`; -1 near the eye.
        faces: (f, 3), counter-clockwise seen from outside.
        double_sided: Whether faces show from behind too.
        corner: The window's first column and row, in samples.
        planes: (f, PLANES), filled for the faces that are seen; or (0, PLANES), left empty.
        nearest: (h, w) inverse depth of the nearest surface, 0 at first.
        shown: (h, w) the face that is seen, filled where `nearest` grows.
        skin: Textures, whose holes are left open.
        part: With a skin, the first face that is drawn and the one behind the last.
    """
    height, width = nearest.shape
    left, above = corner
    start, stop, level, is_small = 0, faces.shape[0], -1, False
    if skin is not None:
        start, stop = part
    # most faces of a large mesh lie between samples, which a point's place shows: once a point
    for i in range(points.shape[0]):
        places[i, 0], places[i, 1] = -1, -1
        if points[i, 2] >= NEAR:
            places[i, 0] = _first(points[i, 3], left, width)
            places[i, 1] = _first(points[i, 4], above, height)
    for f in range(start, stop):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        first, last = 0, height
        begin = min(places[a, 0], places[b, 0], places[c, 0])
        is_before = begin >= 0
        if is_before:
            if begin >= max(places[a, 0], places[b, 0], places[c, 0]):
                continue
            first = min(places[a, 1], places[b, 1], places[c, 1])
            last = max(places[a, 1], places[b, 1], places[c, 1])
            if first >= last:
                continue
        p = (points[a, 0], points[a, 1], points[a, 2])
        q = (points[b, 0], points[b, 1], points[b, 2])
        r = (points[c, 0], points[c, 1], points[c, 2])
        edge_a, edge_b, edge_c = _cross(q, r), _cross(r, p), _cross(p, q)
        # rows run downwards, which mirrors the order of the corners
        volume, side = -dot(p, edge_a), 1.0
        if double_sided and volume < 0.0:
            volume, side = -volume, -1.0
        if not 0.0 < volume < math.inf:  # seen from behind, without area, or not finite
            continue
        edge_a, edge_b, edge_c = scaled(edge_a, -side), scaled(edge_b, -side), scaled(edge_c, -side)
        share, is_seen = 1.0 / volume, False
        across = (edge_a[0] + edge_b[0] + edge_c[0]) * share
        down = (edge_a[1] + edge_b[1] + edge_c[1]) * share
        fixed = (edge_a[2] + edge_b[2] + edge_c[2]) * share
        if skin is not None:
            line_a, line_b, line_c = _line(edge_a), _line(edge_b), _line(edge_c)
            level, is_small = _level_of_holes(points, faces[f], skin.materials[f], skin)
        for j in range(first, last):
            v = above + j + 0.5
            if skin is not None and is_before:  # without a division or a branch a row
                low = max(_at(line_a, 0, v), _at(line_b, 0, v), _at(line_c, 0, v))
                high = min(_at(line_a, 2, v), _at(line_b, 2, v), _at(line_c, 2, v))
            else:
                low, high = _cut(edge_a, v, -math.inf, math.inf)
                low, high = _cut(edge_b, v, low, high)
                low, high = _cut(edge_c, v, low, high)
            rest = down * v + fixed
            for i in range(_first(low, left, width), _first(high, left, width)):
                u = left + i + 0.5
                inverse = across * u + rest
                if nearest[j, i] < inverse <= 1.0 / NEAR:
                    if skin is not None and level >= 0:
                        least = 0.125 + 0.25 * (2 * ((i + j) & 1) + (j & 1)) if is_small else 0.5
                        x = share / inverse * (edge_a[0] * u + edge_a[1] * v + edge_a[2])
                        y = share / inverse * (edge_b[0] * u + edge_b[1] * v + edge_b[2])
                        x, y = uv_at(skin.uv, skin.faces[f], x, y)
                        if texel(skin, level, x, y)[3] < least:
                            continue
                    nearest[j, i], shown[j, i], is_seen = inverse, f, True
        if is_seen and f < planes.shape[0]:  # of a large mesh most faces are hidden
            plane = planes[f]
            for k in range(3):
                plane[k], plane[3 + k] = edge_a[k] * share, edge_b[k] * share
            plane[6], plane[7], plane[8], plane[9] = across, down, fixed, side


@uncounted
def extent(shown: Indices) -> tuple[int, int, int, int]:
    """Find the samples that show a face: first column and row, and last ones + 1; 0 for none."""
    left, top, right, bottom = shown.shape[1], shown.shape[0], 0, 0
    for j in range(shown.shape[0]):
        for i in range(shown.shape[1]):
            if shown[j, i] >= 0:
                left, right = min(left, i), max(right, i + 1)
                top, bottom = min(top, j), j + 1
    return (left, top, right, bottom) if right > 0 else (0, 0, 0, 0)


@inlined
def _level_of_holes(points: Floats, corners: Indices, surface: int, skin: Skin) -> tuple[int, bool]:
    """Return the level of a face's texture with texels as large as samples, -1 without holes.

    And say whether it is smaller than the texture: its texels are then partly solid, and the share
    of a pixel's samples that show them is theirs.
    """
    level, last, has_holes = skin.textures[surface]
    if has_holes == 0:
        return -1, False
    a, b, c = corners[0], corners[1], corners[2]
    if min(points[a, 2], points[b, 2], points[c, 2]) < NEAR:
        return level, False
    texels = _doubled_area(skin.uv, 0, a, b, c) * skin.levels[level, 1] * skin.levels[level, 2]
    samples = _doubled_area(points, 3, a, b, c)
    is_small = texels > 2.0 * samples
    while texels > 2.0 * samples and level < last - 1:
        level, texels = level + 1, 0.25 * texels
    return level, is_small


@inlined
def _doubled_area(places: Floats, k: int, a: int, b: int, c: int) -> float:
    x, y = places[a, k], places[a, k + 1]
    area: float = (places[b, k] - x) * (places[c, k + 1] - y)
    area -= (places[c, k] - x) * (places[b, k + 1] - y)
    return abs(area)


@inlined
def _line(edge: Triple) -> tuple[float, float, float, float]:
    """Return where a row enters a triangle by an edge, and where it leaves by it, for `_at`."""
    if abs(edge[0]) < 1e-30:  # along the rows: the face's rows end at it
        return 0.0, -math.inf, 0.0, math.inf
    slope, place = -edge[1] / edge[0], -edge[2] / edge[0]
    if edge[0] > 0.0:
        return slope, place, 0.0, math.inf
    return 0.0, -math.inf, slope, place


@inlined
def _at(line: tuple[float, float, float, float], k: int, v: float) -> float:
    return line[k] * v + line[k + 1]


@inlined
def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _cut(edge: Triple, v: float, low: float, high: float) -> tuple[float, float]:
    """Keep of the stretch low <= u < high of a row what lies inside an edge."""
    rest = edge[1] * v + edge[2]
    if edge[0] > 0.0:
        return max(low, -rest / edge[0]), high
    if edge[0] < 0.0:
        return low, min(high, -rest / edge[0])
    if rest > 0.0 or (rest == 0.0 and edge[1] > 0.0):
        return low, high
    return math.inf, -math.inf


@inlined
def _first(place: float, start: int, count: int) -> int:
    """Return the first of `count` samples from `start` whose middle is at a place or behind it."""
    return math.ceil(min(max(place - start, 0.0), float(count)) - 0.5)
