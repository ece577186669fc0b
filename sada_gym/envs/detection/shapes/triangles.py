"""What the readers of mesh files return, and how their polygons become triangles."""

from __future__ import annotations

import codecs
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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


def triangulate(points: Points, corners: Indices, sizes: Indices) -> tuple[Indices, Indices]:
    """Cut polygons into triangles: a fan from the first corner, or ears where a fan would not fit.

    Args:
        points: The vertices, (v, 3).
        corners: The polygons' vertices one after another, (c,).
        sizes: How many corners each has, (p,). What has fewer than three has no area.

    Returns:
        The places in `corners` of each triangle's corners, (f, 3), and its polygon, (f,), sorted.
    """
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
