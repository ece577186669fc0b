"""Modelling primitives: closed, low-polygon solids in metres, front +x, left +y, up +z.

Every primitive gives a `Part`, a closed mesh of one material. A class's module makes a list of
them, and `assembly.assemble` turns the list into a `Shape`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
import trimesh

from sada_gym.envs.detection.shapes.assembly import Part
from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.polygon import offset_inwards, triangulate

__all__ = [
    "Array",
    "Part",
    "Point",
    "both_sides",
    "box",
    "cylinder",
    "ellipsoid",
    "extrude",
    "lathe",
    "loft",
    "mirrored",
    "moved",
    "ring",
    "scaled",
    "slab",
    "torus",
    "tube",
    "turned",
]

Array = npt.NDArray[np.float64]
Point = Sequence[float] | Array
"""Three coordinates in metres."""

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_CUT_AXES = np.repeat(~np.eye(3, dtype=bool)[None], 8, axis=0)


def box(
    size: Point,
    centre: Point,
    *,
    taper: tuple[float, float] = (1.0, 1.0),
    shift: tuple[float, float] = (0.0, 0.0),
    chamfer: float = 0.0,
    material: Material = Material.PAINT,
) -> Part:
    """Return a box, optionally tapered to its top and with chamfered edges.

    Args:
        size: Lengths along x, y and z, in metres (3,).
        centre: The centre of the untapered box (3,).
        taper: Factors on the top's extent along x and y.
        shift: How far the top is moved along x and y, in metres.
        chamfer: How much is cut from each edge, in metres; 0 for sharp edges (12 faces, else 44).
        material: What all faces are made of.
    """
    half = np.asarray(size, float) / 2
    corners = _CORNERS
    if chamfer > 0:
        cut = np.minimum(chamfer, 0.98 * half)
        points = (corners[:, None] * (half - _CUT_AXES * cut)).reshape(-1, 3)
    else:
        points = corners * half
    rise = (points[:, 2:] / half[2] + 1) / 2
    points[:, :2] *= 1 + rise * (np.asarray(taper) - 1)
    points[:, :2] += rise * np.asarray(shift)
    mesh = trimesh.Trimesh(
        points + np.asarray(centre, float), _box_faces(chamfer > 0), process=False
    )
    return Part(mesh, material)


def cylinder(
    start: Point,
    end: Point,
    radius: float,
    end_radius: float | None = None,
    *,
    segments: int = 10,
    material: Material = Material.PAINT,
) -> Part:
    """Return a capped cylinder, or a frustum or cone (`end_radius`), between two points (3,)."""
    last = radius if end_radius is None else end_radius
    return tube([start, end], [radius, last], segments=segments, material=material)


def tube(
    points: Sequence[Point] | Array,
    radius: float | Sequence[float],
    *,
    segments: int = 8,
    closed: bool = False,
    material: Material = Material.PAINT,
) -> Part:
    """Return a round tube along a polyline.

    Args:
        points: The centre line (n, 3).
        radius: One radius in metres for all points, or one a point (n,).
        segments: The number of sides of the round cross-section.
        closed: Whether the last point is joined to the first; do not repeat the first then.
        material: What all faces are made of.
    """
    line = np.asarray(points, float)
    radii = np.broadcast_to(np.asarray(radius, float), len(line))
    if closed:
        steps = np.roll(line, -1, axis=0) - line
        before = np.roll(steps, 1, axis=0)
    else:
        steps = np.diff(line, axis=0, append=line[-1:])
        steps[-1] = steps[-2]
        before = np.vstack([steps[:1], steps[:-1]])
    tangents = _unit(_unit(steps) + _unit(before))
    side = np.cross(tangents[0], _AXES["x"] if abs(tangents[0, 0]) < 0.8 else _AXES["z"])
    angles = 2 * np.pi * np.arange(segments) / segments
    rings = []
    for centre, tangent, r in zip(line, tangents, radii, strict=True):
        side = _unit(side - tangent * (side @ tangent))
        up = np.cross(tangent, side)
        rings.append(centre + r * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * up))
    return loft(rings, closed=closed, material=material)


def lathe(
    profile: Sequence[tuple[float, float]] | Array,
    *,
    centre: Point = (0.0, 0.0, 0.0),
    axis: str = "z",
    segments: int = 12,
    material: Material = Material.PAINT,
) -> Part:
    """Return a surface of revolution.

    Args:
        profile: (n, 2) of radius and position along the axis, in metres; ends are capped.
        centre: Where the axis' zero lies (3,).
        axis: "x", "y" or "z".
        segments: The number of faces around the axis.
        material: What all faces are made of.
    """
    outline = np.asarray(profile, float)
    angles = 2 * np.pi * np.arange(segments) / segments
    unit = np.stack([np.cos(angles), np.sin(angles), np.zeros(segments)], axis=1)
    rings = outline[:, :1, None] * unit + outline[:, 1:, None] * np.array([0.0, 0.0, 1.0])
    roll = {"x": 1, "y": 2, "z": 0}[axis]
    return loft(np.roll(rings, roll, axis=2) + np.asarray(centre, float), material=material)


def extrude(
    polygon: Sequence[tuple[float, float]] | Array,
    width: float | Sequence[float] | Array,
    *,
    y: float = 0.0,
    bevel: float = 0.0,
    material: Material = Material.PAINT,
) -> Part:
    """Return a side profile made `width` thick along y.

    Args:
        polygon: (n, 2) of x and z in metres, concave allowed, in either sense, not crossing itself.
        width: The width along y in metres, one for all points or one a point (n,): a car's body is
            narrower at the points of its roof.
        y: Where the middle lies.
        bevel: Width of the chamfer along both rims, in metres; 0 for sharp rims.
        material: What all faces are made of.
    """
    outline = np.asarray(polygon, float)
    halves = np.broadcast_to(np.asarray(width, float) / 2, len(outline))
    inner = offset_inwards(outline, bevel) if bevel > 0 else outline
    levels = [
        (inner, -halves),
        (outline, bevel - halves),
        (outline, halves - bevel),
        (inner, halves),
    ]
    rings = [np.column_stack([xz[:, 0], y + ys, xz[:, 1]]) for xz, ys in levels]
    flat = [np.column_stack([xz, np.zeros(len(xz))]) for xz, _ in (levels[0], levels[-1])]
    return loft(
        rings if bevel > 0 else [rings[0], rings[-1]], caps=(flat[0], flat[1]), material=material
    )


def slab(
    points: Sequence[Point] | Array, thickness: float, *, material: Material = Material.PAINT
) -> Part:
    """Return a flat plate: a planar polygon (n, 3), concave allowed, `thickness` metres thick."""
    outline = np.asarray(points, float)
    normal = _unit(
        np.cross(outline - outline[0], np.roll(outline, -1, axis=0) - outline[0]).sum(axis=0)
    )
    return loft(
        [outline - normal * thickness / 2, outline + normal * thickness / 2], material=material
    )


def ring(
    centre: Point,
    half_y: float,
    half_z: float,
    *,
    segments: int = 12,
    exponent: float = 2.0,
) -> Array:
    """Return a cross-section for `loft` in the plane x = `centre[0]`, (segments, 3).

    Args:
        centre: The ring's centre (3,).
        half_y: Half its width in metres.
        half_z: Half its height in metres.
        segments: Number of points.
        exponent: 2 is an ellipse, 4 and more a rounded rectangle, 1 a rhombus.
    """
    angles = 2 * np.pi * (np.arange(segments) + 0.5) / segments
    cos, sin = np.cos(angles), np.sin(angles)
    radius = (np.abs(cos) ** exponent + np.abs(sin) ** exponent) ** (-1 / exponent)
    offsets = np.column_stack([np.zeros(segments), half_y * radius * cos, half_z * radius * sin])
    return np.asarray(centre, float) + offsets


def loft(
    sections: Sequence[Array] | Array,
    *,
    closed: bool = False,
    caps: tuple[Array, Array] | None = None,
    material: Material = Material.PAINT,
) -> Part:
    """Return the skin over a list of cross-sections, with both ends capped.

    Args:
        sections: k rings of (n, 3) points each, in the same order and sense, not repeating the
            first point. A ring may shrink to a point.
        closed: Whether the last ring is joined to the first (no caps then).
        caps: Flattened images (n, 3) of the first and the last ring on which the caps are
            triangulated; by default the rings themselves, which must then be nearly planar.
        material: What all faces are made of.
    """
    rings = np.asarray(sections, float)
    count, n, _ = rings.shape
    start = np.arange(count if closed else count - 1)[:, None] * n
    here, after = start + np.arange(n), start + np.roll(np.arange(n), -1)
    up = n * count if closed else np.inf
    above, above_after = ((index + n) % up for index in (here, after))
    sides = [np.stack([here, after, above_after], -1), np.stack([here, above_after, above], -1)]
    faces = [part.reshape(-1, 3).astype(np.int64) for part in sides]
    if not closed:
        flat = (rings[0], rings[-1]) if caps is None else caps
        faces += [triangulate(flat[0])[:, ::-1], triangulate(flat[1]) + n * (count - 1)]
    mesh = trimesh.Trimesh(rings.reshape(-1, 3), np.concatenate(faces), process=False)
    corners = mesh.vertices[mesh.faces]
    if np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        mesh.faces = mesh.faces[:, ::-1]
    return Part(mesh, material)


def ellipsoid(
    radii: Point,
    centre: Point,
    *,
    segments: int = 12,
    rings: int = 6,
    material: Material = Material.PAINT,
) -> Part:
    """Return an ellipsoid with semi-axes `radii` (3,) about `centre` (3,), its poles along z."""
    angles = np.linspace(0, np.pi, rings + 1)
    profile = np.column_stack([np.sin(angles), -np.cos(angles)])
    profile[[0, -1], 0] = 0.0
    ball = lathe(profile, segments=segments, material=material)
    return moved(scaled(ball, radii), centre)


def torus(
    centre: Point,
    axis: Point,
    radius: float,
    tube_radius: float,
    *,
    segments: int = 16,
    tube_segments: int = 6,
    material: Material = Material.PAINT,
) -> Part:
    """Return a ring such as a tyre.

    Args:
        centre: The ring's centre (3,).
        axis: Direction (3,), along y for a wheel.
        radius: The distance from the centre to the middle of the tube, in metres.
        tube_radius: The tube's radius, in metres.
        segments: The number of faces around the ring.
        tube_segments: The number of faces around the tube.
        material: What all faces are made of.
    """
    along = _unit(np.asarray(axis, float))
    side = _unit(np.cross(along, _AXES["x"] if abs(along[0]) < 0.8 else _AXES["z"]))
    angles = 2 * np.pi * np.arange(segments)[:, None] / segments
    circle = radius * (np.cos(angles) * side + np.sin(angles) * np.cross(along, side))
    line = circle + np.asarray(centre, float)
    return tube(line, tube_radius, segments=tube_segments, closed=True, material=material)


def moved(part: Part, offset: Point) -> Part:
    """Return the part moved by `offset` (3,) in metres."""
    return _mapped(part, np.eye(3), offset)


def turned(part: Part, axis: str, degrees: float, *, about: Point = (0.0, 0.0, 0.0)) -> Part:
    """Return the part turned, right-handed, about the axis "x", "y" or "z" through `about` (3,)."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = cos
    matrix[first, second], matrix[second, first] = -sin, sin
    centre = np.asarray(about, float)
    return _mapped(part, matrix, centre - matrix @ centre)


def scaled(part: Part, factors: float | Point) -> Part:
    """Return the part scaled about the origin by one factor or one an axis (3,)."""
    return _mapped(part, np.diag(np.broadcast_to(np.asarray(factors, float), 3)), (0.0, 0.0, 0.0))


def mirrored(part: Part) -> Part:
    """Return the part's mirror image in the plane y = 0."""
    return scaled(part, (1.0, -1.0, 1.0))


def both_sides(parts: Part | Iterable[Part]) -> list[Part]:
    """Return the part or parts and their mirror images in the plane y = 0."""
    given = [parts] if isinstance(parts, Part) else list(parts)
    return given + [mirrored(part) for part in given]


@functools.cache
def _box_faces(chamfered: bool) -> npt.NDArray[np.int64]:
    """Return the faces over a box's corners, or over the three points a chamfer leaves of each."""
    points = _CORNERS
    if chamfered:
        points = (_CORNERS[:, None] * (1 - 0.1 * _CUT_AXES)).reshape(-1, 3)
    hull = trimesh.convex.convex_hull(points)
    order = np.array([np.argmin(np.abs(points - vertex).sum(axis=1)) for vertex in hull.vertices])
    return np.asarray(order[hull.faces], np.int64)


def _mapped(part: Part, matrix: Array, offset: Point) -> Part:
    vertices = part.mesh.vertices @ matrix.T + np.asarray(offset, float)
    faces = part.mesh.faces if np.linalg.det(matrix) > 0 else part.mesh.faces[:, ::-1]
    return Part(trimesh.Trimesh(vertices, faces, process=False), part.material)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), float)
