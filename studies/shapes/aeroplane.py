"""Aeroplanes: fuselage, wings, tail, and engines or propeller."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.airframe import (
    fin,
    floats,
    fuselage,
    gear,
    nacelle,
    propeller,
    strut,
    twin,
    wings,
)
from studies.shapes.kit import Part, both_sides, box, cylinder, ellipsoid, torus

STYLES = ("airliner", "fighter", "glider", "highwing", "biplane", "bizjet")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of an aeroplane in metres, the nose along +x; `style`: one of `STYLES`."""
    return _BUILDERS[style](rng)


def _airliner(rng: np.random.Generator) -> list[Part]:
    length, radius = rng.uniform(26, 42), rng.uniform(2.0, 2.6)
    sweep, span = rng.uniform(0.3, 0.7), rng.uniform(13, 20)
    livery = Material.GLASS if rng.random() < 0.6 else Material.LAMP
    nose, tail = length / 2, -length / 2
    parts = [
        fuselage(
            (nose, -0.3 * radius, 0.1, 0.1),
            (nose - 0.8 * radius, -0.15 * radius, 0.6 * radius, 0.6 * radius),
            (nose - 2.4 * radius, 0, radius, radius),
            (tail + 0.3 * length, 0, radius, radius),
            (tail, 0.6 * radius, 0.2 * radius, 0.25 * radius),
        ),
        box(
            (0.55 * length, 2.02 * radius, 0.3 * radius),
            (0.03 * length, 0, 0.3 * radius),
            material=livery,
        ),
        box(
            (0.9 * radius, 1.35 * radius, 0.35 * radius),
            (nose - 1.35 * radius, 0, 0.42 * radius),
            material=Material.GLASS,
        ),
    ]
    root = 0.11 * length
    parts += wings(
        (root, 0, -0.5 * radius),
        0.2 * length,
        span,
        0.05 * length,
        sweep=sweep,
        rise=0.09,
        thickness=0.9,
    )
    parts += wings(
        (tail + 0.14 * length, 0, 0.4 * radius),
        0.11 * length,
        0.36 * span,
        0.04 * length,
        sweep=sweep,
        rise=0.08,
        thickness=0.6,
    )
    parts.append(
        fin(
            (tail + 0.17 * length, 0, 0.6 * radius),
            0.14 * length,
            rng.uniform(2.4, 3.0) * radius,
            0.06 * length,
            sweep=0.7,
        )
    )
    engines = [0.33] if rng.random() < 0.6 else [0.28, 0.55]
    for share in engines:
        at = (root - sweep * share * span + 1.2, share * span, -0.95 * radius + 0.06 * share * span)
        parts += both_sides(
            nacelle(at, 0.42 * radius * (1.15 if len(engines) == 1 else 0.85), 2.0 * radius)
        )
    return parts


def _fighter(rng: np.random.Generator) -> list[Part]:
    length, width = rng.uniform(13, 16), rng.uniform(0.85, 1.05)
    delta = rng.random() < 0.5
    nose, tail = 0.55 * length, -0.45 * length
    parts = [
        fuselage(
            (nose, -0.1, 0.05, 0.05),
            (nose - 0.16 * length, 0, 0.5 * width, 0.5 * width),
            (nose - 0.36 * length, 0.05, 0.9 * width, 0.8 * width),
            (nose - 0.55 * length, 0, 1.35 * width, 0.85 * width),
            (tail, 0, 0.9 * width, 0.75 * width),
        ),
        ellipsoid(
            (0.13 * length, 0.5 * width, 0.65 * width),
            (nose - 0.27 * length, 0, 0.6 * width),
            segments=10,
            material=Material.GLASS,
        ),
        cylinder(
            (tail + 0.1, 0, 0),
            (tail - 0.06 * length, 0, 0),
            0.75 * width,
            0.55 * width,
            material=Material.DARK,
        ),
    ]
    root_chord = (0.5 if delta else 0.34) * length
    reach = rng.uniform(0.33, 0.4) * length
    root = (nose - (0.38 if delta else 0.42) * length, 0, 0)
    parts += wings(
        root,
        root_chord,
        reach,
        0.12 * root_chord,
        sweep=1.1 if delta else 0.75,
        rise=0.0,
        thickness=0.28,
    )
    if not delta:
        parts += wings(
            (tail + 0.2 * length, 0, 0),
            0.17 * length,
            0.2 * length,
            0.06 * length,
            sweep=0.7,
            rise=0.0,
            thickness=0.22,
        )
    tail_fin = fin(
        (tail + 0.24 * length, 0, 0.4 * width),
        0.22 * length,
        rng.uniform(2.2, 2.8) * width,
        0.07 * length,
        sweep=0.8,
        thickness=0.25,
    )
    parts += twin(tail_fin, 0.9 * width) if rng.random() < 0.5 else [tail_fin]
    for y in (0.55 * reach, 0.8 * reach):
        x = root[0] - (1.1 if delta else 0.75) * y
        parts += both_sides(
            cylinder(
                (x - 1.4, y, -0.35), (x + 0.8, y, -0.35), 0.16, material=Material.LAMP, segments=6
            )
        )
    return parts


def _glider(rng: np.random.Generator) -> list[Part]:
    length, reach = rng.uniform(6.6, 8.6), rng.uniform(5.2, 7.2)
    nose, tail = 0.36 * length, -0.64 * length
    parts = [
        fuselage(
            (nose, -0.1, 0.06, 0.06),
            (nose - 0.08 * length, 0, 0.32, 0.36),
            (nose - 0.24 * length, 0.08, 0.42, 0.52),
            (nose - 0.45 * length, 0.1, 0.3, 0.33),
            (tail, 0.15, 0.16, 0.18),
        ),
        ellipsoid(
            (0.13 * length, 0.34, 0.36),
            (nose - 0.17 * length, 0, 0.34),
            segments=10,
            material=Material.GLASS,
        ),
        torus(
            (nose - 0.27 * length, 0, -0.42),
            (0, 1, 0),
            0.2,
            0.09,
            segments=10,
            material=Material.RUBBER,
        ),
    ]
    parts += wings(
        (nose - 0.24 * length, 0, 0.32),
        rng.uniform(0.95, 1.25),
        reach,
        rng.uniform(0.45, 0.7),
        sweep=0.04,
        rise=rng.uniform(0.03, 0.13),
        thickness=0.2,
    )
    top = rng.uniform(1.15, 1.5)
    parts.append(fin((tail + 0.95, 0, 0.1), 0.95, top, 0.65, sweep=0.3, thickness=0.15))
    parts += wings(
        (tail + 0.62, 0, 0.1 + (0.94 if rng.random() < 0.6 else 0.2) * top),
        0.6,
        1.35,
        0.36,
        sweep=0.12,
        rise=0.0,
        thickness=0.13,
    )
    return parts


def _highwing(rng: np.random.Generator) -> list[Part]:
    length, reach = rng.uniform(6.8, 9.0), rng.uniform(4.4, 6.0)
    nose, tail = 0.38 * length, -0.62 * length
    chord = rng.uniform(1.45, 1.7)
    parts = [
        fuselage(
            (nose, -0.1, 0.42, 0.4),
            (nose - 0.9, -0.1, 0.56, 0.52),
            (nose - 1.7, 0.12, 0.64, 0.8),
            (nose - 3.1, 0.12, 0.62, 0.78),
            (tail, 0.1, 0.1, 0.22),
            exponent=4.0,
        ),
        box((1.7, 1.3, 0.5), (nose - 2.25, 0, 0.5), taper=(0.75, 0.95), material=Material.GLASS),
    ]
    high = 0.92
    parts += wings(
        (nose - 1.35, 0, high), chord, reach, 0.8 * chord, sweep=0.03, rise=0.03, thickness=0.24
    )
    parts += both_sides(
        cylinder(
            (nose - 1.7, 0.6, -0.4),
            (nose - 1.9, 0.5 * reach, high),
            0.07,
            segments=6,
            material=Material.METAL,
        )
    )
    parts += wings((tail + 1.15, 0, 0.15), 1.05, 1.75, 0.7, sweep=0.15, rise=0.0, thickness=0.15)
    parts.append(
        fin((tail + 1.3, 0, 0.1), 1.25, rng.uniform(1.5, 1.8), 0.7, sweep=0.5, thickness=0.17)
    )
    parts += propeller((nose, 0, -0.1), rng.uniform(0.9, 1.1), rng)
    if rng.random() < 0.3:
        return parts + floats(nose - 1.9, 0.8 * length)
    parts += gear(nose - 2.1, 1.15, -1.25, -0.5, 0.34)
    parts += [
        cylinder(
            (nose - 0.4, 0, -0.4), (nose - 0.3, 0, -1.25), 0.06, segments=6, material=Material.METAL
        ),
        torus((nose - 0.3, 0, -1.3), (0, 1, 0), 0.17, 0.1, segments=10, material=Material.RUBBER),
    ]
    return parts


def _biplane(rng: np.random.Generator) -> list[Part]:
    length, reach = rng.uniform(5.8, 7.6), rng.uniform(3.6, 4.8)
    nose, tail = 0.36 * length, -0.64 * length
    chord, gap = rng.uniform(1.1, 1.5), rng.uniform(1.35, 1.85)
    shorter = rng.uniform(0.75, 1.0)
    low, high = -0.42, -0.42 + gap
    parts = [
        fuselage(
            (nose, 0, 0.5, 0.5),
            (nose - 0.25, 0, 0.58, 0.58),
            (nose - 1.2, 0, 0.55, 0.6),
            (nose - 2.9, 0.02, 0.45, 0.52),
            (tail, 0.1, 0.08, 0.16),
        ),
        ellipsoid(
            (0.5, 0.28, 0.2), (nose - 2.35, 0, 0.55), segments=8, rings=4, material=Material.DARK
        ),
        ellipsoid(
            (0.2, 0.18, 0.26), (nose - 2.5, 0, 0.75), segments=8, rings=4, material=Material.WOOD
        ),
    ]
    lead = nose - 0.55
    for z, ahead, share in ((low, -0.25, shorter), (high, 0.0, 1.0)):
        parts += wings(
            (lead + ahead, 0, z),
            chord,
            share * reach,
            0.92 * chord,
            sweep=0.03,
            rise=0.03,
            thickness=0.17,
        )
    for x in (lead - 0.35, lead - 1.05):
        parts += both_sides(
            strut(
                (x - 0.2, 0.72 * shorter * reach, low),
                (x, 0.72 * shorter * reach, high + 0.05),
                0.08,
            )
        )
        parts += both_sides(strut((x, 0.35, 0.3), (x, 0.55, high), 0.07))
    parts += wings((tail + 0.95, 0, 0.15), 0.95, 1.35, 0.6, sweep=0.25, rise=0.0, thickness=0.13)
    parts.append(
        fin((tail + 0.85, 0, 0.1), 0.95, rng.uniform(1.0, 1.25), 0.55, sweep=0.35, thickness=0.14)
    )
    parts += propeller((nose, 0, 0), rng.uniform(1.05, 1.25), rng)
    parts += gear(nose - 0.9, 0.8, -1.25, -0.4, 0.36)
    return parts


def _bizjet(rng: np.random.Generator) -> list[Part]:
    length, radius = rng.uniform(13, 20), rng.uniform(0.95, 1.2)
    reach = rng.uniform(6.0, 9.0)
    nose, tail = length / 2, -length / 2
    parts = [
        fuselage(
            (nose, -0.3 * radius, 0.06, 0.06),
            (nose - 1.4 * radius, -0.1, 0.62 * radius, 0.6 * radius),
            (nose - 3.2 * radius, 0, radius, radius),
            (tail + 0.32 * length, 0, radius, radius),
            (tail, 0.5 * radius, 0.15, 0.15),
        ),
        box(
            (1.0 * radius, 1.45 * radius, 0.42 * radius),
            (nose - 2.1 * radius, 0, 0.5 * radius),
            taper=(0.6, 0.9),
            material=Material.GLASS,
        ),
    ]
    for x in np.linspace(nose - 4 * radius, tail + 0.42 * length, int(rng.integers(4, 8))):
        parts.append(
            box(
                (0.5 * radius, 2.02 * radius, 0.36 * radius),
                (x, 0, 0.35 * radius),
                material=Material.GLASS,
            )
        )
    parts += wings(
        (0.08 * length, 0, -0.6 * radius),
        0.2 * length,
        reach,
        0.07 * length,
        sweep=0.4,
        rise=0.06,
        thickness=0.4,
    )
    pod = (tail + 0.34 * length, 1.5 * radius, 0.5 * radius)
    parts += both_sides(nacelle(pod, 0.5 * radius, 2.6 * radius))
    parts.append(box((1.2 * radius, 2.6 * radius, 0.2), (tail + 0.3 * length, 0, 0.45 * radius)))
    top = rng.uniform(2.2, 2.7) * radius
    parts.append(
        fin(
            (tail + 0.2 * length, 0, 0.4 * radius),
            0.17 * length,
            top,
            0.1 * length,
            sweep=0.75,
            thickness=0.3,
        )
    )
    parts += wings(
        (tail + 0.2 * length - 0.7 * top, 0, 0.4 * radius + top),
        0.1 * length,
        0.34 * reach,
        0.05 * length,
        sweep=0.45,
        rise=0.0,
        thickness=0.26,
    )
    return parts


_BUILDERS = {
    "airliner": _airliner,
    "fighter": _fighter,
    "glider": _glider,
    "highwing": _highwing,
    "biplane": _biplane,
    "bizjet": _bizjet,
}
