"""What the readers of mesh files return, how polygons become triangles, and how these turn."""

from __future__ import annotations

import codecs
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sada_gym.envs.detection.shapes.surface import Material, Surface
from sada_gym.errors import UserError

MAX_FACES = 500_000
"""Triangles of one file: they take some 12 seconds to load, and 0.4 seconds a picture."""

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Triangles:
    """The triangles of one file, along its own axes.

    Attributes:
        vertices: (v, 3) float64.
        faces: (f, 3) int64.
        uv: (f, 3, 2) float64, of each face's corners; None where no surface has a texture.
        surface: (f,) int64, indices into surfaces; all 0 where there are none.
        surfaces: What the faces are made of; empty where the file says nothing, or was not asked.
    """

    vertices: Points
    faces: Indices
    uv: Points | None
    surface: Indices
    surfaces: tuple[Surface, ...] = ()


def look(opacity: float, gloss: float) -> Material:
    """Choose whose gloss and reflectance a surface has, by its opacity and its mirror's share."""
    if opacity < 1:
        return Material.GLASS
    return Material.PAINT if gloss > 0.5 else Material.DARK


def as_text(content: bytes) -> str:
    """Decode a text, whose comments and names may be in any encoding."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def check_count(faces: int) -> None:
    """Raise `UserError` for more triangles than are rendered in good time."""
    if faces > MAX_FACES:
        raise UserError(
            f"{faces:,} faces, where at most {MAX_FACES:,} are rendered in good time: reduce them, "
            "such as with Blender's Decimate modifier"
        )


def check_corners(corners: Indices, vertices: int) -> None:
    """Raise `UserError` if faces have corners that are none of the vertices."""
    if len(corners) and not 0 <= corners.min() <= corners.max() < vertices:
        raise UserError("faces that point at missing vertices")


def triangulate(points: Points, corners: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """Cut polygons into triangles: a fan from the first corner, or ears where a fan would not fit.

    It raises `UserError` for too many triangles, and for corners that are no vertices.

    Args:
        points: The vertices, (v, 3).
        corners: The polygons' vertices one after another, (c,).
        sizes: How many corners each has, (p,). What has fewer than three has no area.

    Returns:
        The places in `corners` of each triangle's corners, (f, 3), and its polygon, (f,), sorted.
    """
    check_corners(corners, len(points))
    check_count(int((sizes - 2).clip(0).sum()))
    starts = np.cumsum(sizes) - sizes
    triangles, owners = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for size in np.unique(sizes[sizes >= 3]).tolist():
        polygons = np.flatnonzero(sizes == size)
        fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], 1)
        if size == 4:
            fan[1] = 2, 3, 0
        cut = np.repeat(fan[None], len(polygons), axis=0)
        places = starts[polygons][:, None] + np.arange(size)
        if size > 3:
            outlines = points[corners[places]]
            for row in np.flatnonzero(~_fans_fit(outlines, fan)).tolist():
                cut[row] = _ears(outlines[row], fan)
        triangles.append((starts[polygons][:, None, None] + cut).reshape(-1, 3))
        owners.append(np.repeat(polygons, size - 2))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _newell(outlines: Points) -> Points:
    following = np.roll(outlines, -1, axis=-2)
    return np.asarray(np.cross(outlines, following).sum(axis=-2))


def _fans_fit(outlines: Points, fan: Indices) -> npt.NDArray[np.bool_]:
    """Say of each outline (k, n, 3) whether no triangle of its fan is turned over."""
    relative = outlines - outlines[:, :1]  # far from the origin, a cross product loses digits
    normal = _newell(relative)
    a, b, c = (relative[:, fan[:, i]] for i in range(3))
    turned = np.einsum("kti,ki->kt", np.cross(b - a, c - a), normal)
    return np.asarray((turned >= -1e-6 * (normal**2).sum(axis=1)[:, None]).all(axis=1))


def _ears(outline: Points, fan: Indices) -> Indices:
    """Cut ears off one polygon (n, 3), seen along its normal, until a triangle is left.

    An outline that crosses itself has no inside; it gets the fan.
    """
    relative = outline - outline[0]
    normal = _newell(relative)
    drop = int(np.abs(normal).argmax())
    across, up = ((1, 2), (2, 0), (0, 1))[drop]
    flat = relative[:, [across, up]] * ([1, 1] if normal[drop] > 0 else [-1, 1])
    left, ears = list(range(len(flat))), []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat, left, i)), None)
        if ear is None:
            return fan
        ears.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*ears, left])


def _is_ear(flat: Points, left: list[int], i: int) -> bool:
    a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
    if _turn(flat[a], flat[b], flat[c]) < 0:
        return False
    others = flat[[k for k in left if k not in (a, b, c)]]
    sides = [_turn(flat[p], flat[q], others) for p, q in ((a, b), (b, c), (c, a))]
    # corners that lie on a bridge between an outline and its hole come twice
    apart = (others[:, None] != flat[[a, b, c]]).any(axis=2).all(axis=1)
    return not bool((np.minimum.reduce(sides) > 0)[apart].any())


def _turn(a: Points, b: Points, c: Points) -> Points:
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


def equal_rows(rows: Points, decimals: int) -> tuple[Indices, Indices]:
    """Return the first of each kind of row, rounded, and for each row the number of its kind."""
    keys = np.ascontiguousarray(np.round(rows, decimals) + 0.0)  # -0 becomes 0
    order = np.lexsort(keys.T)
    new = np.ones(len(rows), bool)
    new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    kind = np.empty(len(rows), np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


def components(pairs: Indices, count: int) -> Indices:
    """Number the connected parts of a graph of `count` nodes by their first ones; pairs (p, 2)."""
    graph = coo_array((np.ones(len(pairs), bool), pairs.T), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def wound(mesh: Triangles) -> Triangles:
    """Merge vertices within 1e-8; turn faces like their neighbours, and closed bodies outward."""
    first, kind = equal_rows(mesh.vertices, 8)
    used, corners = np.unique(first[kind][mesh.faces], return_inverse=True)
    points, faces = mesh.vertices[used], corners.reshape(-1, 3)
    count = len(faces)
    edges, ends = _edges(faces)
    a, b = _pairs(ends).T
    a, b = a[a // 3 != b // 3], b[a // 3 != b // 3]
    # each face is there twice, as it is and turned; neighbours that run along an edge in the same
    # direction agree if one of them is turned
    other = b // 3 + np.where(edges[a, 0] == edges[b, 0], count, 0)
    sides = np.stack([np.append(a // 3, a // 3 + count), np.append(other, (other + count))], 1)
    side = components(sides % (2 * count), 2 * count).reshape(2, -1)
    turned, body = side[1] < side[0], side.min(axis=0)
    faces[turned] = faces[turned, ::-1]
    edges, ends = _edges(faces)
    a, b = _pairs(np.column_stack([np.repeat(body, 3), ends])).T
    matched = np.bincount(body[a[edges[a, 0] != edges[b, 0]] // 3], minlength=2 * count)
    p, q, r = points[faces].swapaxes(0, 1)
    volume = np.bincount(body, np.einsum("fi,fi->f", p, np.cross(q, r)), 2 * count)
    closed = 2 * matched == 3 * np.bincount(body, minlength=2 * count)
    inside_out = (closed & (volume < 0))[body]
    faces[inside_out] = faces[inside_out, ::-1]
    return replace(mesh, vertices=points, faces=faces)


def _edges(faces: Indices) -> tuple[Indices, Indices]:
    """Return the edges of faces, (3 f, 2), from vertex to vertex, and with the lower one first."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    return edges, np.sort(edges, axis=1)


def _pairs(keys: Indices) -> Indices:
    """Return the pairs, (p, 2), of those rows that are there exactly twice."""
    order = np.lexsort(keys.T)
    same = (keys[order[1:]] == keys[order[:-1]]).all(axis=1)
    after, before = np.append(same, False), np.append(False, same)
    first = np.flatnonzero(after[:-1] & ~before[:-1] & ~after[1:])
    return np.stack([order[first], order[first + 1]], axis=1)
