"""What vehicles share: wheels, wheel arches, bodies cut out for them, cabins and window panes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Array,
    Part,
    Point,
    both_sides,
    cylinder,
    extrude,
    lathe,
    slab,
    torus,
)

Outline = list[tuple[float, float]]
"""Points of a side profile, x and z in metres."""


def around(rng: np.random.Generator, value: float, share: float = 0.06) -> float:
    """Draws uniformly within `share` of a value, on either side of it."""
    return float(value * rng.uniform(1 - share, 1 + share))


def wheel(
    centre: Point,
    radius: float,
    width: float,
    *,
    segments: int = 12,
    rim: float = 0.62,
    material: Material = Material.METAL,
) -> list[Part]:
    """Return a tyre and its rim, which looks away from the plane y = 0.

    Args:
        centre: The tyre's centre (3,); its y is not zero.
        radius: The tyre's radius, in metres.
        width: The width along y, in metres.
        segments: The number of faces around the axle.
        rim: The rim's radius as a share of the tyre's.
        material: What the rim is made of.
    """
    out = 1.0 if centre[1] > 0 else -1.0
    half = width / 2
    tread = [
        (rim * radius, -half),
        (radius, -0.8 * half),
        (radius, 0.8 * half),
        (rim * radius, half),
    ]
    dish = [
        (rim * radius, 0.9 * half),
        (0.9 * rim * radius, 1.15 * half),
        (0.25 * radius, 1.02 * half),
    ]
    return [
        lathe(tread, centre=centre, axis="y", segments=segments, material=Material.RUBBER),
        lathe(
            [(r, out * y) for r, y in dish],
            centre=centre,
            axis="y",
            segments=segments,
            material=material,
        ),
    ]


def axle(
    x: float,
    radius: float,
    track: float,
    width: float,
    *,
    segments: int = 12,
    rim: float = 0.62,
) -> list[Part]:
    """Return a left and a right wheel on z = 0, their outer faces `track` metres apart."""
    centre = (x, (track - width) / 2, radius)
    return both_sides(wheel(centre, radius, width, segments=segments, rim=rim))


def spoked_wheel(
    centre: Point,
    radius: float,
    *,
    tyre: float = 0.022,
    rim: float = 0.014,
    spokes: int = 8,
    spoke: float = 0.009,
    rim_material: Material = Material.METAL,
) -> list[Part]:
    """Return a wheel of a bicycle or motorbike: tyre, rim, spokes and hub, its axle along y.

    Args:
        centre: The wheel's centre (3,).
        radius: Outer radius of the tyre, in metres.
        tyre: Radius of the tyre's tube.
        rim: Radius of the rim's tube.
        spokes: How many, evenly spread.
        spoke: Radius of a spoke.
        rim_material: What the rim alone is made of.
    """
    middle = np.asarray(centre, float)
    inner = radius - 2 * tyre
    side = np.array([0.0, 2.5 * tyre, 0.0])
    parts = [
        torus(middle, (0, 1, 0), radius - tyre, tyre, tube_segments=5, material=Material.RUBBER),
        torus(middle, (0, 1, 0), inner, rim, tube_segments=4, material=rim_material),
        cylinder(middle - side, middle + side, 1.6 * tyre, segments=8, material=Material.METAL),
    ]
    for angle in 2 * np.pi * (np.arange(spokes) + 0.25) / spokes:
        end = middle + inner * np.array([np.cos(angle), 0.0, np.sin(angle)])
        parts.append(cylinder(middle, end, spoke, segments=4, material=Material.METAL))
    return parts


def mudguard(
    centre: Point,
    radius: float,
    width: float,
    span_deg: tuple[float, float],
    *,
    thickness: float = 0.02,
    segments: int = 7,
    material: Material = Material.PAINT,
) -> Part:
    """Return a curved band of inner `radius` about a wheel; angles run from +x over +z."""
    angles = np.radians(np.linspace(*span_deg, segments + 1))
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    band = np.concatenate([radius * unit, (radius + thickness) * unit[::-1]])
    return extrude(
        band + np.array([centre[0], centre[2]]), width, y=float(centre[1]), material=material
    )


def arch(x: float, z: float, radius: float, sill: float, *, segments: int = 6) -> Outline:
    """Return the cut for a wheel at (x, z) into a bottom edge at z = `sill`, from front to rear."""
    start = np.arcsin((sill - z) / radius)
    angles = np.linspace(start, np.pi - start, segments + 1)
    return [(x + radius * float(np.cos(a)), z + radius * float(np.sin(a))) for a in angles]


def hull(
    upper: Sequence[tuple[float, float]],
    wheels: Iterable[float],
    *,
    sill: float,
    wheel_radius: float,
    width: float,
    bevel: float = 0.08,
    ends: float = 1.0,
    gap: float = 0.06,
) -> Part:
    """Return a body with wheel arches: the side profile, extruded.

    Args:
        upper: The profile's (n, 2) points x, z from the lower rear corner over the top to the lower
            front corner.
        wheels: x of the axles, in any order.
        sill: z of the bottom edge.
        wheel_radius: The radius of the wheels, which stand on z = 0.
        width: The width along y, in metres.
        bevel: Chamfer along both sides, in metres.
        ends: Width of the outermost 3 % of the length as a share of `width`.
        gap: Between tyre and arch, in metres.
    """
    outline = list(upper)
    for x in sorted(wheels, reverse=True):
        outline += arch(x, wheel_radius, wheel_radius + gap, sill)
    xs = np.array([x for x, _ in outline])
    edge = 0.03 * np.ptp(xs)
    outer = (xs < xs.min() + edge) | (xs > xs.max() - edge)
    return extrude(outline, np.where(outer, ends * width, width), bevel=bevel)


@dataclass(frozen=True)
class Cabin:
    """A box that tapers upwards, such as a car's passenger cell: ranges in metres.

    Attributes:
        base: x of its rear and front at the bottom.
        roof: x of its rear and front at the top.
        z: The heights of bottom and top.
        width: The widths along y at bottom and top.
    """

    base: tuple[float, float]
    roof: tuple[float, float]
    z: tuple[float, float]
    width: tuple[float, float]

    def solid(self, *, crown: float = 0.0, material: Material = Material.PAINT) -> Part:
        """Return the closed body, its roof raised by `crown` metres in the middle."""
        (rear, front), (low, high), (wide, narrow) = self.roof, self.z, self.width
        outline = [(self.base[0], low), (rear, high)]
        widths = [wide, narrow]
        if crown:
            step = 0.3 * (front - rear)
            outline += [(rear + step, high + crown), (front - step, high + crown)]
            widths += [narrow, narrow]
        outline += [(front, high), (self.base[1], low)]
        return extrude(outline, [*widths, narrow, wide], material=material)

    def side(self) -> Array:
        """Return the left face (4, 3): bottom rear, bottom front, top front, top rear."""
        low, high = self.width[0] / 2, self.width[1] / 2
        return np.array(
            [
                [self.base[0], low, self.z[0]],
                [self.base[1], low, self.z[0]],
                [self.roof[1], high, self.z[1]],
                [self.roof[0], high, self.z[1]],
            ]
        )

    def front(self) -> Array:
        """Return the front face (4, 3): bottom right, bottom left, top left, top right."""
        return self._end(1)

    def rear(self) -> Array:
        """Return the rear face (4, 3): bottom right, bottom left, top left, top right."""
        return self._end(0)

    def _end(self, end: int) -> Array:
        base, roof = self.base[end], self.roof[end]
        low, high = self.width[0] / 2, self.width[1] / 2
        return np.array(
            [
                [base, -low, self.z[0]],
                [base, low, self.z[0]],
                [roof, high, self.z[1]],
                [roof, -high, self.z[1]],
            ]
        )


def wall(x: tuple[float, float], z: tuple[float, float], y: float) -> Array:
    """Return an upright rectangle (4, 3) along x, to carry panes."""
    return np.array([[x[0], y, z[0]], [x[1], y, z[0]], [x[1], y, z[1]], [x[0], y, z[1]]])


def spread(count: int, *, gap: float = 0.2, start: float = 0.0, end: float = 1.0) -> Outline:
    """Divides the range from `start` to `end` into spans with a share `gap` of each left free."""
    edges = np.linspace(start, end, count + 1)
    free = gap * (end - start) / count / 2
    return [(float(a + free), float(b - free)) for a, b in pairwise(edges)]


def panes(
    face: Array,
    spans: Iterable[tuple[float, float]] = ((0.08, 0.92),),
    *,
    rise: tuple[float, float] = (0.12, 0.9),
    proud: float = 0.02,
    material: Material = Material.GLASS,
) -> list[Part]:
    """Return flat panes that stand out of a four-cornered face.

    Args:
        face: (4, 3) corners: bottom start, bottom end, top end, top start.
        spans: Start and end of each pane along the face's bottom, as shares of it.
        rise: Lower and upper edge of the panes as shares of the face's height.
        proud: How far they stand out, in metres.
        material: What the panes are made of.
    """
    parts = []
    for u in spans:
        corners = [_at(face, u[i], rise[j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        parts.append(slab(corners, 2 * proud, material=material))
    return parts


def _at(face: Array, u: float, v: float) -> Array:
    low = face[0] + u * (face[1] - face[0])
    high = face[3] + u * (face[2] - face[3])
    return np.asarray(low + v * (high - low))
