"""Joins parts to a `Shape`: its normals, outward faces, its place on the ground, its scale."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.model import DIAGONAL, Material, Shape, Surface
from sada_gym.envs.detection.shapes.triangles import Triangles, components, equal_rows
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

CREASE_DEG = 40.0
"""Edges whose faces turn by more than this are shaded as sharp."""

_Array = npt.NDArray[np.float64]
_Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Part:
    """A closed mesh of one material, such as `Triangles` or a mesh of trimesh.

    Its vertices (v, 3) are in metres, its faces (f, 3) counter-clockwise seen from outside.
    """

    mesh: Any
    material: Material = Material.PAINT


def assemble(name: str, object_class: str, parts: Sequence[Part]) -> Shape:
    """Join parts to one shape by the conventions of `Shape`.

    Each part keeps its own normals: vertices are doubled along edges sharper than `CREASE_DEG`.
    Faces without area are dropped. A part that encloses a negative volume is turned inside out.
    The parts are in metres, front +x, up +z.

    Raises:
        ValueError: If no face has area, or a coordinate is not finite.
    """
    points = np.concatenate([np.asarray(part.mesh.vertices, float) for part in parts])
    if not np.isfinite(points).all():
        raise UserError(f"Expected finite coordinates in {name}, got NaN or infinity; fix them.")
    faces = np.concatenate([part.mesh.faces for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.mesh.faces) for part in parts])
    faces += np.cumsum([0] + [len(part.mesh.vertices) for part in parts[:-1]])[owner, None]
    faces, kept = _welded(points, faces, owner)
    if not len(faces):
        raise UserError(f"Expected {name} to have a face with area, got none; give a solid part.")
    owner = owner[kept]
    corners = points[faces]
    volume = np.zeros(len(parts))
    triple = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    np.add.at(volume, owner, triple)
    inside_out = volume[owner] < 0
    faces[inside_out] = faces[inside_out][:, ::-1]
    corners = points[faces]
    material = np.array([int(part.material) for part in parts], np.uint8)[owner]
    return _shape(name, object_class, corners, _creased_normals(corners, faces), material)


def assemble_textured(
    name: str, object_class: str, mesh: Triangles, rotation: _Array, painted: Collection[str] = ()
) -> Shape:
    """Make a shape with the surfaces of a file; rotation (3, 3) turns its axes to those of `Shape`.

    Surfaces whose names match one of the patterns `painted`, such as `body*`, take the scene's
    colour. All faces show from both sides.

    Raises:
        ValueError: If no face has area, or no surface matches a pattern.
    """
    points = mesh.vertices @ rotation.T
    faces, kept = _welded(points, mesh.faces, np.zeros(len(mesh.faces), np.int64))
    if not len(faces):
        raise UserError("faces without area")
    used, material = np.unique(mesh.surface[kept], return_inverse=True)
    surfaces = _painted([mesh.surfaces[index] for index in used], painted)
    textured = any(surface.texture is not None for surface in surfaces)
    uv = mesh.uv[kept] if textured and mesh.uv is not None else None
    corners = points[faces]
    normals = _creased_normals(corners, faces)
    return _shape(name, object_class, corners, normals, material, surfaces=surfaces, uv=uv)


def _painted(surfaces: Sequence[Surface], patterns: Collection[str]) -> tuple[Surface, ...]:
    painted = [any(fnmatchcase(item.name, pattern) for pattern in patterns) for item in surfaces]
    if patterns and not any(painted):
        names = ", ".join(sorted({shown(surface.name) for surface in surfaces}))
        raise UserError(
            f"no material {' or '.join(map(repr, patterns))} that could be painted, but {names}"
        )
    return tuple(
        replace(item, painted=is_so) for item, is_so in zip(surfaces, painted, strict=True)
    )


def _shape(
    name: str,
    object_class: str,
    corners: _Array,
    normals: _Array,
    material: npt.NDArray[np.uint8] | _Indices,
    surfaces: tuple[Surface, ...] = (),
    uv: _Array | None = None,
) -> Shape:
    """Place corners (f, 3, 3), with uv (f, 3, 2), by the conventions; equal ones are one vertex."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    placed = (corners - origin) * (DIAGONAL / np.linalg.norm(high - low))
    columns = [placed, normals] if uv is None else [placed, normals, uv]
    rows = np.concatenate(columns, axis=2).reshape(3 * len(corners), -1).astype(np.float32)
    # Vertices are shared only within one material, so that a renderer may split by material.
    first, inverse = equal_rows(np.column_stack([rows, np.repeat(material, 3)]), 5)
    vertices = rows[first]
    length = np.linalg.norm(vertices[:, 3:6], axis=1, keepdims=True)
    return Shape(
        name=name,
        object_class=object_class,
        vertices=vertices[:, :3],
        normals=vertices[:, 3:6] / length,
        faces=inverse.reshape(-1, 3).astype(np.int32),
        materials=material.astype(np.uint16) if surfaces else material.astype(np.uint8),
        double_sided=bool(surfaces),
        surfaces=surfaces,
        uv=None if uv is None else vertices[:, 6:],
    )


def _welded(points: _Array, faces: _Indices, owner: _Indices) -> tuple[_Indices, _Indices]:
    """Let a part's faces share vertices that lie together; say which faces have area."""
    part = np.zeros(len(points))
    part[faces.ravel()] = np.repeat(owner, 3)
    span = float(np.ptp(points, axis=0).max()) or 1.0
    first, same = equal_rows(np.column_stack([points / span, part]), 7)
    faces = first[same][faces]
    doubled = _doubled_areas(points[faces])
    kept = np.flatnonzero(np.linalg.norm(doubled, axis=1) > 1e-10 * span**2)
    return faces[kept], kept


def _doubled_areas(corners: _Array) -> _Array:
    """Return the normals of faces with corners (f, 3, 3), as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _creased_normals(corners: _Array, faces: _Indices) -> _Array:
    doubled = _doubled_areas(corners)
    flat = doubled / np.linalg.norm(doubled, axis=1, keepdims=True)
    group = _smooth_groups(faces, flat)
    weighted = _corner_angles(corners)[..., None] * flat[:, None]
    total = np.zeros((int(group.max(initial=-1)) + 1, 3))
    np.add.at(total, group, weighted.reshape(-1, 3))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.divide(total, length, out=total, where=length > 1e-9)
    normals = total[group].reshape(-1, 3, 3)
    # where neighbours cancel each other (folded sheets), a face's own normal serves
    lost = np.einsum("fki,fi->fk", normals, flat) < 0.1
    normals[lost] = np.broadcast_to(flat[:, None], normals.shape)[lost]
    return np.asarray(normals)


def _smooth_groups(faces: _Indices, normals: _Array) -> _Indices:
    count = len(faces)
    corner = np.arange(3 * count).reshape(-1, 3)
    # the two vertices of each edge, the lower number first, and the corners where they lie
    ends, places = (np.stack([row, np.roll(row, -1, axis=1)], -1) for row in (faces, corner))
    order = ends.argsort(axis=-1)
    ends, places = (np.take_along_axis(pair, order, -1).reshape(-1, 2) for pair in (ends, places))
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, places = ends[order], places[order]
    joined = (ends[1:] == ends[:-1]).all(axis=1)
    a, b = places[:-1][joined], places[1:][joined]
    turn = np.einsum("ei,ei->e", normals[a[:, 0] // 3], normals[b[:, 0] // 3])
    smooth = turn > np.cos(np.radians(CREASE_DEG))
    pairs = np.column_stack([a[smooth].ravel(), b[smooth].ravel()])
    return components(pairs, 3 * count)


def _corner_angles(soup: _Array) -> _Array:
    """Return the angle (f, 3) at each corner, which weighs a face's share in the normal there."""
    to_next = np.roll(soup, -1, axis=1) - soup
    to_last = np.roll(soup, 1, axis=1) - soup
    cosine = (to_next * to_last).sum(axis=2)
    cosine /= np.linalg.norm(to_next, axis=2) * np.linalg.norm(to_last, axis=2)
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))
