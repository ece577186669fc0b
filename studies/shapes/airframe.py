"""Parts of aeroplanes: fuselage, wings, fins, engines, propeller and landing gear."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Array,
    Part,
    Point,
    both_sides,
    cylinder,
    lathe,
    loft,
    mirrored,
    ring,
    torus,
)


def fuselage(*stations: tuple[float, float, float, float], exponent: float = 2.0) -> Part:
    """Skins ellipses at (x, z, half width, half height) in metres, from nose to tail."""
    return loft(
        [ring((x, 0, z), half_y, half_z, exponent=exponent) for x, z, half_y, half_z in stations]
    )


def _aerofoil(chord: float, thickness: float) -> Array:
    """Return a section (6, 2): along the chord, backwards from the leading edge, and across it."""
    along = -chord * np.array([0.0, 0.12, 0.4, 1.0, 0.4, 0.12])
    return np.column_stack([along, thickness / 2 * np.array([0.0, 0.75, 1.0, 0.0, -1.0, -0.75])])


def wings(
    root: tuple[float, float, float],
    chord: float,
    reach: float,
    tip_chord: float,
    *,
    sweep: float,
    rise: float,
    thickness: float,
) -> list[Part]:
    """Return both wings, `reach` long each; sweep and rise are the slopes backwards and upwards."""
    sections = []
    for share, c, t in ((0.0, chord, thickness), (1.0, tip_chord, 0.7 * thickness)):
        lead = np.array([root[0] - sweep * share * reach, root[2] + rise * share * reach])
        xz = lead + _aerofoil(c, t)
        sections.append(np.column_stack([xz[:, 0], np.full(6, share * reach), xz[:, 1]]))
    left = loft(sections)
    return [left, mirrored(left)]


def fin(
    root: tuple[float, float, float],
    chord: float,
    height: float,
    tip_chord: float,
    *,
    sweep: float,
    thickness: float = 0.5,
) -> Part:
    """Return the vertical tail, with the leading edge's foot at `root`."""
    sections = []
    for share, c in ((0.0, chord), (1.0, tip_chord)):
        lead = np.array([root[0] - sweep * share * height, 0.0])
        xy = lead + _aerofoil(c, thickness)
        sections.append(np.column_stack([xy, np.full(6, root[2] + share * height)]))
    return loft(sections)


def twin(fin: Part, y: float) -> list[Part]:
    """Return two fins, canted outwards, in place of one."""
    low = fin.mesh.vertices[:, 2].min()
    vertices = fin.mesh.vertices + [0, y, 0] + 0.25 * (fin.mesh.vertices[:, 2:] - low) * [0, 1, 0]
    mesh = fin.mesh.copy()
    mesh.vertices = vertices
    return both_sides(Part(mesh))


def nacelle(centre: tuple[float, float, float], radius: float, length: float) -> list[Part]:
    """Return a jet engine with its intake to the front."""
    outline = [
        (0.0, -0.5),
        (0.55, -0.5),
        (0.8, -0.25),
        (1.0, 0.2),
        (0.9, 0.5),
        (0.75, 0.42),
        (0.0, 0.42),
    ]
    profile = [(radius * r, length * x) for r, x in outline]
    front = centre[0] + 0.44 * length
    return [
        lathe(profile, centre=centre, axis="x", segments=10),
        cylinder(
            (front - 0.1, *centre[1:]), (front, *centre[1:]), 0.75 * radius, material=Material.DARK
        ),
    ]


def propeller(
    hub: tuple[float, float, float], radius: float, rng: np.random.Generator
) -> list[Part]:
    """Return a spinner and two or three blades `radius` long, in a random position."""
    x, _, z = hub
    blades = [
        cylinder((x - 0.05, 0, z), (x + 0.35, 0, z), 0.2, 0.04, segments=8, material=Material.METAL)
    ]
    start = rng.uniform(0, np.pi)
    count = int(rng.integers(2, 4))
    for angle in start + 2 * np.pi * np.arange(count) / count:
        tip = (x + 0.12, radius * np.cos(angle), z + radius * np.sin(angle))
        blades.append(
            cylinder((x + 0.12, 0, z), tip, 0.08, 0.13, segments=6, material=Material.DARK)
        )
    return blades


def strut(start: Point, end: Point, radius: float) -> Part:
    """Return a biplane's wooden strut."""
    return cylinder(start, end, radius, segments=6, material=Material.WOOD)


def floats(x: float, length: float) -> list[Part]:
    """Return a seaplane's two floats about `x`, and their struts."""
    pontoon = [
        ring((x + dx * length, 1.15, z), w, h, exponent=3.0, segments=8)
        for dx, z, w, h in (
            (0.42, -1.3, 0.05, 0.05),
            (0.3, -1.45, 0.28, 0.26),
            (0.0, -1.5, 0.34, 0.34),
            (-0.5, -1.35, 0.12, 0.12),
        )
    ]
    struts = [
        cylinder(
            (x + dx, 1.1, -1.3), (x + dx, 0.45, -0.3), 0.08, segments=6, material=Material.METAL
        )
        for dx in (0.8, -0.6)
    ]
    return both_sides([loft(pontoon), *struts])


def gear(x: float, y: float, wheel_z: float, body_z: float, radius: float) -> list[Part]:
    """Return a wheel on a leg on either side."""
    return both_sides(
        [
            cylinder((x, 0.35, body_z), (x, y, wheel_z), 0.07, segments=6, material=Material.METAL),
            torus(
                (x, y, wheel_z),
                (0, 1, 0),
                0.62 * radius,
                0.38 * radius,
                segments=12,
                material=Material.RUBBER,
            ),
        ]
    )
