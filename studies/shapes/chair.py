"""Chairs: one seat with a back, on legs, a pedestal or castors."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Part,
    both_sides,
    box,
    cylinder,
    ellipsoid,
    torus,
    tube,
    turned,
)

STYLES = ("dining", "office", "armchair", "bar", "folding", "windsor")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one chair in metres, the sitter looking along +x, in one of `STYLES`."""
    return _BUILDERS[style](rng)


def _dining(rng: np.random.Generator) -> list[Part]:
    """Return four square legs, and a back of slats across, slats upright, or one panel."""
    width, seat, top = rng.uniform(0.4, 0.52), rng.uniform(0.42, 0.5), rng.uniform(0.82, 1.15)
    depth, lean = rng.uniform(0.38, 0.48), rng.uniform(0.02, 0.16)
    y, x = width / 2 - 0.025, depth / 2 - 0.025
    legs = Material.WOOD if rng.random() < 0.5 else Material.PAINT
    parts = [box((depth, width, 0.055), (0, 0, seat - 0.02), chamfer=0.015)]
    parts += both_sides(
        [
            box((0.04, 0.04, seat - 0.03), (x, y, (seat - 0.03) / 2), material=legs),
            box((0.04, 0.04, seat), (-x, y, seat / 2), material=legs),
        ]
    )
    parts += both_sides(box((0.04, 0.04, top - seat), (-x, y, (top + seat) / 2), shift=(-lean, 0)))
    kind = rng.integers(3)
    high = top - seat
    if kind == 0:
        for share in (0.35, 0.62, 0.89):
            parts.append(
                box((0.03, width - 0.06, 0.16 * high), (-x - share * lean, 0, seat + share * high))
            )
    elif kind == 1:
        parts.append(
            box((0.035, width - 0.06, 0.16 * high), (-x - 0.9 * lean, 0, seat + 0.9 * high))
        )
        for share in (-0.28, 0.0, 0.28):
            parts.append(
                box(
                    (0.025, 0.05, 0.86 * high),
                    (-x, share * width, seat + 0.43 * high),
                    shift=(-0.86 * lean, 0),
                )
            )
    else:
        parts.append(
            box(
                (0.045, width - 0.05, 0.8 * high),
                (-x - 0.2 * lean, 0, seat + 0.6 * high),
                shift=(-0.8 * lean, 0),
                chamfer=0.015,
            )
        )
    return parts


def _office(rng: np.random.Generator) -> list[Part]:
    """Return a padded seat and back on a gas spring and a star of five castors."""
    width, seat, back = rng.uniform(0.44, 0.56), rng.uniform(0.44, 0.58), rng.uniform(0.36, 0.68)
    parts = [
        box((0.48, width, 0.1), (0, 0, seat), chamfer=0.035),
        cylinder((0, 0, 0.1), (0, 0, seat - 0.04), 0.032, segments=8, material=Material.METAL),
        box((0.05, 0.1, 0.3), (-0.26, 0, seat + 0.1), shift=(-0.02, 0), material=Material.DARK),
        box((0.28, 0.1, 0.05), (-0.13, 0, seat - 0.07), material=Material.DARK),
        turned(
            box(
                (0.08, 0.92 * width, back),
                (-0.25, 0, seat + 0.12 + back / 2),
                taper=(0.7, rng.uniform(0.75, 1.0)),
                chamfer=0.03,
            ),
            "y",
            -9,
            about=(-0.25, 0, seat),
        ),
    ]
    for angle in rng.uniform(0, 1.2) + 2 * np.pi * np.arange(5) / 5:
        foot = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        parts.append(
            cylinder((0, 0, 0.13), (*foot, 0.085), 0.032, 0.022, segments=6, material=Material.DARK)
        )
        parts.append(
            ellipsoid(
                (0.036, 0.036, 0.036), (*foot, 0.036), segments=8, rings=4, material=Material.RUBBER
            )
        )
    if rng.random() < 0.3:
        rest = box((0.07, 0.28, 0.14), (-0.36 - 0.1 * back, 0, seat + 0.2 + back), chamfer=0.02)
        parts += [
            rest,
            box(
                (0.03, 0.06, 0.16),
                (-0.34 - 0.1 * back, 0, seat + 0.1 + back),
                material=Material.DARK,
            ),
        ]
    if rng.random() < 0.6:
        y, high = width / 2 + 0.035, seat + 0.22
        parts += both_sides(
            [
                box((0.26, 0.06, 0.035), (0.0, y, high), chamfer=0.012, material=Material.DARK),
                tube(
                    [(0, width / 2 - 0.05, seat - 0.04), (0, y, seat), (0, y, high)],
                    0.02,
                    segments=6,
                    material=Material.DARK,
                ),
            ]
        )
    return parts


def _armchair(rng: np.random.Generator) -> list[Part]:
    """Return an upholstered easy chair."""
    width, deep, seat = rng.uniform(0.72, 1.02), rng.uniform(0.7, 0.92), rng.uniform(0.4, 0.47)
    back, arm, thick = rng.uniform(0.76, 1.12), rng.uniform(0.52, 0.68), rng.uniform(0.1, 0.2)
    x, foot = deep / 2, rng.uniform(0.07, 0.18)
    parts = [
        box((deep - 0.1, width - thick, 0.2), (0.03, 0, foot + 0.1)),
        box(
            (deep - 0.2, width - 2 * thick, seat - 0.27), (0.09, 0, (seat + 0.29) / 2), chamfer=0.04
        ),
        box(
            (0.2, width - 0.6 * thick, back - foot),
            (-x + 0.1, 0, (back + foot) / 2),
            shift=(-rng.uniform(0.05, 0.14), 0),
            taper=(0.8, 0.94),
            chamfer=0.06,
        ),
    ]
    parts += both_sides(
        box(
            (deep - 0.06, thick, arm - foot),
            (0.03, (width - thick) / 2, (arm + foot) / 2),
            chamfer=0.045,
        )
    )
    for at in (x - 0.08, -x + 0.08):
        parts += both_sides(
            cylinder(
                (at, width / 2 - 0.09, foot + 0.02),
                (at, width / 2 - 0.07, 0),
                0.035,
                0.022,
                segments=8,
                material=Material.WOOD,
            )
        )
    return parts


def _bar(rng: np.random.Generator) -> list[Part]:
    """Return a bar stool with a low back: four splayed legs with rungs, or a pedestal."""
    seat, radius, back = rng.uniform(0.62, 0.82), rng.uniform(0.18, 0.23), rng.uniform(0.2, 0.4)
    parts = [cylinder((0, 0, seat - 0.07), (0, 0, seat), 0.94 * radius, radius, segments=14)]
    angles = np.linspace(np.radians(115), np.radians(245), 7)
    rail = np.column_stack([1.02 * radius * np.cos(angles), 1.02 * radius * np.sin(angles)])
    for level in (0.72, 1.0) if rng.random() < 0.5 else (0.4, 0.7, 1.0):
        parts.append(
            tube(
                np.column_stack([rail * (1 + 0.12 * level), np.full(7, seat + back * level)]),
                0.032,
                segments=6,
            )
        )
    for xy in (rail[0], rail[3], rail[6]):
        parts.append(
            cylinder(
                (*(0.9 * xy), seat - 0.05),
                (*(1.12 * xy), seat + back),
                0.02,
                segments=6,
                material=Material.METAL,
            )
        )
    if rng.random() < 0.5:
        parts.append(
            cylinder((0, 0, 0.03), (0, 0, seat - 0.05), 0.035, segments=8, material=Material.METAL)
        )
        parts.append(
            cylinder((0, 0, 0), (0, 0, 0.05), 0.22, 0.13, segments=14, material=Material.METAL)
        )
        parts.append(
            torus((0, 0, 0.28), (0, 0, 1), 0.15, 0.016, segments=12, material=Material.METAL)
        )
        parts.append(
            cylinder((0.15, 0, 0.28), (-0.15, 0, 0.28), 0.016, segments=6, material=Material.METAL)
        )
        return parts
    feet = [(0.21 * a, 0.21 * b) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    rung = rng.uniform(0.24, 0.36)
    legs = [
        (np.array([*foot, 0.0]), np.array([0.62 * foot[0], 0.62 * foot[1], seat - 0.04]))
        for foot in feet
    ]
    parts += [cylinder(low, high, 0.022, segments=6) for low, high in legs]
    joints = [low + (high - low) * rung / seat for low, high in legs]
    parts += [
        cylinder(joints[i - 1], joints[i], 0.017, segments=6, material=Material.METAL)
        for i in range(4)
    ]
    return parts


def _folding(rng: np.random.Generator) -> list[Part]:
    """Return a slatted garden chair on crossed legs."""
    width, seat, top = rng.uniform(0.4, 0.52), rng.uniform(0.41, 0.47), rng.uniform(0.76, 0.98)
    back, lean = -0.18, rng.uniform(0.06, 0.22)
    y = width / 2
    frame = Material.METAL if rng.random() < 0.5 else Material.PAINT
    parts = []
    for x in np.linspace(-0.15, 0.2, int(rng.integers(3, 6))):
        parts.append(box((0.065, width, 0.03), (x, 0, seat)))
    for share in np.linspace(0.35, 0.96, int(rng.integers(2, 5))):
        parts.append(
            box(
                (0.028, width, 0.085),
                (back - share * lean, 0, seat + share * (top - seat)),
                shift=(-0.02, 0),
            )
        )
    rod = 0.022
    parts += both_sides(
        [
            tube(
                [(0.24, y, 0), (back + 0.02, y, seat), (back - lean, y, top)],
                rod,
                segments=6,
                material=frame,
            ),
            cylinder(
                (-0.26, y - 0.04, 0), (0.2, y - 0.04, seat - 0.01), rod, segments=6, material=frame
            ),
        ]
    )
    parts.append(cylinder((0.2, -y, 0.08), (0.2, y, 0.08), 0.018, segments=6, material=frame))
    parts.append(cylinder((-0.22, -y, 0.05), (-0.22, y, 0.05), 0.018, segments=6, material=frame))
    return parts


def _windsor(rng: np.random.Generator) -> list[Part]:
    """Return a hooped back of spindles over a saddle seat and splayed turned legs."""
    width, seat, high = rng.uniform(0.42, 0.54), rng.uniform(0.41, 0.48), rng.uniform(0.38, 0.64)
    lean = rng.uniform(0.05, 0.2)
    parts = [cylinder((0, 0, seat - 0.05), (0, 0, seat), 0.46 * width, 0.5 * width, segments=14)]
    angles = np.linspace(0, np.pi, 11)
    half, base = 0.46 * width, -0.13
    rise = high * np.sin(angles) ** 0.6
    hoop = np.column_stack(
        [
            base - 0.05 * np.sin(angles) - lean * rise / high,
            half * np.cos(angles),
            seat - 0.02 + rise,
        ]
    )
    parts.append(tube(hoop, 0.02, segments=6))
    for share in np.linspace(-0.72, 0.72, int(rng.integers(5, 8))):
        tip = high * (1 - share**2) ** 0.3
        start = (base - 0.05 * (1 - share**2), 0.8 * share * half, seat - 0.02)
        parts.append(
            cylinder(
                start,
                (start[0] - lean * tip / high, share * half, seat - 0.02 + tip),
                0.0135,
                segments=6,
            )
        )
    for x in (0.13, -0.13):
        parts += both_sides(
            tube(
                [
                    (1.6 * x, 0.46 * width, 0),
                    (1.3 * x, 0.38 * width, 0.5 * seat),
                    (x, 0.3 * width, seat - 0.03),
                ],
                [0.018, 0.028, 0.02],
                segments=6,
                material=Material.WOOD,
            )
        )
    parts += both_sides(
        cylinder(
            (0.18, 0.4 * width, 0.2),
            (-0.18, 0.4 * width, 0.2),
            0.016,
            segments=6,
            material=Material.WOOD,
        )
    )
    parts.append(
        cylinder(
            (0, -0.4 * width, 0.2), (0, 0.4 * width, 0.2), 0.016, segments=6, material=Material.WOOD
        )
    )
    if rng.random() < 0.4:
        y = 0.46 * width
        parts += both_sides(
            [
                tube(
                    [
                        (base - 0.06, 0.9 * y, seat + 0.22),
                        (0.0, 1.12 * y, seat + 0.22),
                        (0.16, 1.05 * y, seat + 0.21),
                    ],
                    0.02,
                    segments=6,
                ),
                cylinder(
                    (0.1, 0.8 * y, seat - 0.03), (0.13, 1.08 * y, seat + 0.21), 0.016, segments=6
                ),
            ]
        )
    return parts


_BUILDERS = {
    "dining": _dining,
    "office": _office,
    "armchair": _armchair,
    "bar": _bar,
    "folding": _folding,
    "windsor": _windsor,
}
