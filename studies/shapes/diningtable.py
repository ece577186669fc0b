"""Dining tables: a top at table height on legs, a pedestal or trestles, some of them laid."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Part,
    both_sides,
    box,
    cylinder,
    lathe,
    moved,
    scaled,
    turned,
)

STYLES = ("rectangular", "round", "trestle", "oval", "square", "cloth")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of a table in metres, its long side along y; `style` is one of `STYLES`."""
    return _BUILDERS[style](rng)


def _rectangular(rng: np.random.Generator) -> list[Part]:
    """Return four legs at the corners under an apron, laid for two or four."""
    length, depth, height = rng.uniform(1.2, 2.0), rng.uniform(0.75, 1.0), rng.uniform(0.71, 0.8)
    thick, leg = rng.uniform(0.035, 0.07), rng.uniform(0.06, 0.11)
    x, y = depth / 2 - 0.07, length / 2 - 0.08
    foot = (1 / rng.uniform(0.6, 1.0),) * 2
    parts = [_top(depth, length, height, thick)]
    under = height - thick
    for at in (x, -x):
        parts += both_sides(
            box((leg / foot[0], leg / foot[1], under), (at, y, under / 2), taper=foot)
        )
        parts.append(box((0.025, 2 * y, 0.09), (at, 0, under - 0.045), material=Material.WOOD))
    parts += both_sides(box((2 * x, 0.025, 0.09), (0, y, under - 0.045), material=Material.WOOD))
    places = [(side * 0.26, share * length) for share in (-0.22, 0.22) for side in (1, -1)]
    return parts + _laid(places[: 2 * int(rng.integers(0, 3))], height, rng)


def _round(rng: np.random.Generator) -> list[Part]:
    """Return a round top on a turned pedestal with three or four feet or a disc."""
    radius, height = rng.uniform(0.44, 0.72), rng.uniform(0.71, 0.8)
    parts = [cylinder((0, 0, height - 0.045), (0, 0, height), radius, segments=24)]
    waist = rng.uniform(0.04, 0.1)
    stem = [
        (0.1, 0.06),
        (0.09, 0.16),
        (waist, 0.24),
        (waist, 0.5),
        (0.08, 0.62),
        (0.16, height - 0.045),
    ]
    parts.append(lathe(stem, segments=10))
    feet = int(rng.integers(2, 5))
    if feet == 2:
        parts.append(cylinder((0, 0, 0), (0, 0, 0.07), 0.6 * radius, 0.2 * radius, segments=16))
    else:
        for k in range(feet):
            foot = box(
                (0.62 * radius, 0.07, 0.14),
                (0.36 * radius, 0, 0.07),
                taper=(0.35, 0.8),
                shift=(-0.2 * radius, 0),
            )
            parts.append(turned(foot, "z", 360 * k / feet + 45))
    places = [
        (0.6 * radius * np.cos(a), 0.6 * radius * np.sin(a))
        for a in 2 * np.pi * (np.arange(4) + 0.5) / 4
    ]
    return parts + _laid(places, height, rng)


def _trestle(rng: np.random.Generator) -> list[Part]:
    """Return planks over two trestles joined by a stretcher."""
    length, depth, height = rng.uniform(1.3, 2.1), rng.uniform(0.75, 1.0), rng.uniform(0.71, 0.8)
    y, planks = 0.34 * length, int(rng.integers(3, 5))
    parts = []
    for x in depth / planks * (np.arange(planks) - (planks - 1) / 2):
        parts.append(box((0.95 * depth / planks, length, 0.05), (x, 0, height - 0.025)))
    crossed = rng.random() < 0.5
    reach, under = 0.4 * depth, height - 0.05
    for side in (y, -y):
        parts.append(
            box((0.9 * depth, 0.08, 0.06), (0, side, under - 0.03), material=Material.WOOD)
        )
        ends = (
            ((-reach, reach), (reach, -reach))
            if crossed
            else ((-reach, -0.4 * reach), (reach, 0.4 * reach))
        )
        parts += [_beam((low, side, 0.0), (high, side, under - 0.05)) for low, high in ends]
        if not crossed:
            parts.append(box((1.5 * reach, 0.05, 0.06), (0, side, 0.24), material=Material.WOOD))
    parts.append(
        box((0.05, 2 * y, 0.08), (0, 0, 0.5 * under if crossed else 0.24), material=Material.WOOD)
    )
    return parts + _laid([(0.0, 0.0)] * int(rng.integers(0, 2)), height, rng)


def _oval(rng: np.random.Generator) -> list[Part]:
    """Return an oval top on two columns, or on splayed round legs."""
    length, depth, height = rng.uniform(1.3, 2.1), rng.uniform(0.85, 1.1), rng.uniform(0.71, 0.8)
    oval = scaled(cylinder((0, 0, -0.05), (0, 0, 0), 0.42, 0.5, segments=24), (depth, length, 1))
    parts = [moved(oval, (0, 0, height))]
    if rng.random() < 0.5:
        for y in (0.24 * length, -0.24 * length):
            parts.append(
                moved(
                    lathe(
                        [(0.1, 0), (0.05, 0.2), (0.05, 0.45), (0.12, height - 0.04)], segments=10
                    ),
                    (0, y, 0),
                )
            )
            parts.append(box((0.62 * depth, 0.1, 0.07), (0, y, 0.035), taper=(0.8, 0.8)))
        parts.append(box((0.06, 0.48 * length, 0.06), (0, 0, 0.3), material=Material.WOOD))
    else:
        for x in (0.3 * depth, -0.3 * depth):
            parts += both_sides(
                cylinder(
                    (1.2 * x, 0.36 * length, 0),
                    (x, 0.29 * length, height - 0.04),
                    0.024,
                    0.045,
                    segments=8,
                )
            )
    places = [
        (0.0, 0.33 * length),
        (0.0, -0.33 * length),
        (0.27 * depth, 0.0),
        (-0.27 * depth, 0.0),
    ]
    return parts + _laid(places, height, rng)


def _square(rng: np.random.Generator) -> list[Part]:
    """Return a square table whose legs are joined crosswise near the ground."""
    side, height, leg = rng.uniform(0.8, 1.2), rng.uniform(0.7, 0.8), rng.uniform(0.05, 0.1)
    thick, low = rng.uniform(0.035, 0.06), rng.uniform(0.1, 0.25)
    at = side / 2 - rng.uniform(0.05, 0.12)
    parts = [_top(side, side, height, thick)]
    material = Material.WOOD if rng.random() < 0.4 else Material.PAINT
    for x in (at, -at):
        parts += both_sides(
            box((leg, leg, height - thick), (x, at, (height - thick) / 2), material=material)
        )
    for degrees in (45, -45):
        parts.append(
            turned(
                box((2 * at * np.sqrt(2), 0.05, 0.05), (0, 0, low), material=Material.WOOD),
                "z",
                degrees,
            )
        )
    places = [(0.3 * side, 0.0), (-0.3 * side, 0.0), (0.0, 0.3 * side), (0.0, -0.3 * side)]
    return parts + _laid(places, height, rng)


def _cloth(rng: np.random.Generator) -> list[Part]:
    """Return a laid table under a cloth that hangs over all its sides."""
    length, depth, height = rng.uniform(1.1, 1.8), rng.uniform(0.8, 1.05), rng.uniform(0.71, 0.8)
    drop, flare = rng.uniform(0.14, 0.36), rng.uniform(0.92, 0.99)
    parts = [
        box(
            (depth / flare, length / flare, drop),
            (0, 0, height - drop / 2),
            taper=(flare, flare),
            chamfer=0.02,
        ),
    ]
    x, y, under = depth / 2 - 0.07, length / 2 - 0.07, height - 0.1
    for at in (x, -x):
        parts += both_sides(
            cylinder((at, y, 0), (at, y, under), 0.03, 0.045, segments=8, material=Material.WOOD)
        )
    places = [(s * 0.26 * depth, share * length) for share in (-0.25, 0.25) for s in (1, -1)]
    return parts + _laid(places, height, rng)


_BUILDERS = {
    "rectangular": _rectangular,
    "round": _round,
    "trestle": _trestle,
    "oval": _oval,
    "square": _square,
    "cloth": _cloth,
}


def _top(depth: float, length: float, height: float, thick: float) -> Part:
    return box((depth, length, thick), (0, 0, height - thick / 2), chamfer=0.01)


def _beam(low: tuple[float, float, float], high: tuple[float, float, float]) -> Part:
    """Return a square beam between two points that differ in x and z."""
    size = (0.07, 0.07, high[2] - low[2])
    return box(size, (low[0], low[1], (low[2] + high[2]) / 2), shift=(high[0] - low[0], 0))


def _laid(places: list[tuple[float, float]], height: float, rng: np.random.Generator) -> list[Part]:
    """Return a plate at each place (x, y), and a vase or bowl in the middle of some tables."""
    parts = []
    for x, y in places:
        plate = [(0.07, 0.0), (0.125, 0.022), (0.115, 0.022), (0.06, 0.008)]
        parts.append(lathe(plate, centre=(x, y, height), segments=12, material=Material.LAMP))
    choice = rng.random()
    if choice < 0.35:
        vase = [(0.04, 0), (0.06, 0.06), (0.025, 0.14), (0.04, 0.18)]
        parts.append(lathe(vase, centre=(0, 0, height), segments=10, material=Material.GLASS))
    elif choice < 0.7:
        bowl = [(0.05, 0), (0.13, 0.07), (0.115, 0.07), (0.04, 0.02)]
        parts.append(lathe(bowl, centre=(0, 0, height), segments=12, material=Material.METAL))
    return parts
