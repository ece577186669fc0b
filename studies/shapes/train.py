"""Trains: locomotives, railcars and trams, on bogies and a piece of track."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, both_sides, box
from studies.shapes.locomotives import diesel, shunter, steam
from studies.shapes.rolling_stock import (
    bogie,
    buffers,
    canopy,
    double_ended,
    floor,
    pantograph,
    raked_face,
    shell,
    track,
)
from studies.shapes.wheels import around, panes, spread, wall

STYLES = ("steam", "electric", "highspeed", "railcar", "diesel", "tram", "shunter")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one train in metres, its front along +x; `style` is one of `STYLES`."""
    builders = {
        "steam": steam,
        "electric": _electric,
        "highspeed": _highspeed,
        "railcar": _railcar,
        "diesel": diesel,
        "tram": _tram,
        "shunter": shunter,
    }
    return builders[style](rng)


def _electric(rng: np.random.Generator) -> list[Part]:
    half, top = around(rng, 5.9, 0.14), around(rng, 4.1, 0.03)
    rake, low = float(rng.uniform(0.5, 1.2)), 1.25
    belt = low + 1.25
    nose = half - 0.12
    ends = [
        (nose - rake - 0.3, 3.0, low, top),
        (nose, 2.7, low, belt),
        (half, 2.6, low, belt - 0.25),
    ]
    body, _ = shell(double_ended(ends))
    parts = [body, floor(-half + 0.3, half - 0.3, low)]
    for sign in (1.0, -1.0):
        face = raked_face((nose, belt), (nose - rake - 0.3, top - 0.25), 1.08, sign=sign)
        parts += panes(face, [(0.0, 0.47), (0.53, 1.0)], rise=(0.06, 0.86), proud=0.1)
        parts += buffers(sign * half, int(sign))
        parts += bogie(sign * 0.58 * half, base=2.6, radius=0.5)
        parts += pantograph(sign * 0.48 * half, top, reach=1.1 if sign < 0 else 0.35)
    side = wall((-half + 2.2, half - 2.2), (low + 0.9, top - 0.9), 1.5)
    grilles = panes(
        side,
        spread(int(rng.integers(4, 7)), gap=0.3),
        rise=(0.25, 1),
        proud=0.05,
        material=Material.DARK,
    )
    cab = wall((half - rake - 1.4, half - rake - 0.6), (belt, top - 0.85), 1.5)
    windows = panes(cab, [(0, 1)], rise=(0, 1), proud=0.05)
    rear = panes(cab * [-1, 1, 1], [(0, 1)], rise=(0, 1), proud=0.05)
    stripe = wall((-half + 0.8, half - 0.8), (low + 0.3, low + 0.5), 1.5)
    trim = panes(stripe, [(0, 1)], rise=(0, 1), proud=0.04, material=Material.LAMP)
    roof = box((2.2, 1.6, 0.4), (0, 0, top + 0.1))
    return [
        *parts,
        *both_sides([*grilles, *windows, *rear, *trim]),
        roof,
        *track(-half - 1, half + 1),
    ]


def _highspeed(rng: np.random.Generator) -> list[Part]:
    rear, nose = -around(rng, 5.4, 0.2), 6.8
    length, top, low = around(rng, 4.8, 0.2), around(rng, 3.9, 0.03), 0.8
    at = nose - length
    blunt = float(rng.uniform(0.3, 0.55))
    body, rings = shell(
        [
            (rear, 2.9, low, top),
            (at, 2.9, low, top),
            (at + 0.3 * length, 2.8, low, top - 0.45),
            (at + 0.6 * length, 2.45, low - 0.1, top - 1.35),
            (nose - 0.12 * length, 1.8, low - 0.15, low + 1.0 + 0.4 * blunt),
            (nose, 0.8 * blunt + 0.3, low + 0.15, low + 0.5),
        ]
    )
    parts = [body, canopy(rings, (0.05, 0.85))]
    gangway = box((0.5, 1.6, 2.6), (rear - 0.2, 0, 2.2), material=Material.DARK)
    band = wall((rear + 0.4, at - 0.2), (low + 1.25, low + 2.05), 1.45)
    door = wall((at - 0.1, at + 0.75), (low + 0.35, low + 2.1), 1.45)
    stripe = wall((rear, at + 0.2 * length), (low + 0.72, low + 0.9), 1.45)
    sides = [
        *panes(band, spread(5, gap=0.12), rise=(0, 1), proud=0.06),
        *panes(door, [(0, 1)], rise=(0, 1), proud=0.05, material=Material.DARK),
        *panes(stripe, [(0, 1)], rise=(0, 1), proud=0.06, material=Material.LAMP),
        box(
            (0.8, 0.3, 0.25),
            (nose - 0.17 * length, 0.8, low + 0.9),
            shift=(-0.3, 0),
            material=Material.LAMP,
        ),
    ]
    skirt = box(
        (at - rear + 2.0, 2.3, 0.3), ((at + rear) / 2 + 1, 0, low - 0.1), material=Material.DARK
    )
    parts += bogie(rear + 2.1) + bogie(at - 0.2)
    return [
        *parts,
        gangway,
        skirt,
        *both_sides(sides),
        *pantograph(rear + 4, top, reach=0.8),
        *track(rear - 0.8, nose + 0.5),
    ]


def _railcar(rng: np.random.Generator) -> list[Part]:
    half, top, low = around(rng, 6.5, 0.13), around(rng, 3.95, 0.03), 1.15
    slope = float(rng.uniform(0.1, 0.5))
    body, _ = shell(
        [(-half, 2.85, low, top), (half - slope, 2.85, low, top), (half, 2.7, low, top - 0.3)]
    )
    parts = [body, floor(-half + 0.2, half - 0.2, low)]
    doors = [-0.52 * half, 0.52 * half] if rng.random() < 0.5 else [-0.64 * half, 0.0, 0.64 * half]
    edges = [-half + 0.5, *(x + sign * 0.85 for x in doors for sign in (-1, 1)), half - slope - 0.4]
    sides: list[Part] = []
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        count = max(1, round((end - start) / 1.5))
        face = wall((start, end), (low + 1.05, low + 2.0), 1.425)
        sides += panes(face, spread(count, gap=0.18), rise=(0, 1), proud=0.05)
    for x in doors:
        frame = wall((x - 0.7, x + 0.7), (low + 0.1, low + 2.1), 1.425)
        sides += panes(frame, [(0, 1)], rise=(0, 1), proud=0.04, material=Material.METAL)
        sides += panes(frame, spread(2, gap=0.3), rise=(0.48, 0.93), proud=0.07)
    parts += both_sides(sides) + _flat_end(half, low, top) + _flat_end(-half, low, top)
    units = [box((1.8, 1.5, 0.35), (share * half, 0, top + 0.12)) for share in (0.0, 0.55)]
    parts += [*units, *pantograph(-0.55 * half, top, reach=1.0)]
    parts += buffers(half, 1) + buffers(-half, -1) + bogie(0.66 * half) + bogie(-0.66 * half)
    return [*parts, *track(-half - 0.9, half + 0.9)]


def _flat_end(x: float, low: float, top: float) -> list[Part]:
    """Return a railcar's end: two screens, a door between them, and the route's sign."""
    sign = 1 if x > 0 else -1
    at = x - 0.02 * sign
    screen = box((0.16, 0.78, 0.95), (at, 0.84, low + 1.5), material=Material.GLASS)
    door = box((0.18, 0.62, 1.8), (at, 0, low + 1.15), material=Material.DARK)
    label = box((0.3, 0.9, 0.24), (at - 0.05 * sign, 0, top - 0.5), material=Material.LAMP)
    return [*both_sides(screen), door, label]


def _tram(rng: np.random.Generator) -> list[Part]:
    half, top, low = around(rng, 5.6, 0.13), around(rng, 3.5, 0.03), 0.75
    slant = float(rng.uniform(0.6, 1.2))
    ends = [
        (half - slant, 2.5, low, top),
        (half - 0.15, 2.0, low, low + 1.2),
        (half, 1.9, low, low + 0.8),
    ]
    body, _ = shell(double_ended(ends))
    parts = [body]
    for sign in (1.0, -1.0):
        face = raked_face((half - 0.15, low + 1.2), (half - slant, top - 0.2), 0.95, sign=sign)
        parts += panes(face, [(0.0, 1.0)], rise=(-0.05, 0.82), proud=0.1)
        label = [(0.25, 0.75)]
        parts += panes(face, label, rise=(0.88, 1.02), proud=0.14, material=Material.LAMP)
        lamp = box((0.2, 0.34, 0.24), (sign * half, 0.62, low + 0.4), material=Material.LAMP)
        parts += [*both_sides(lamp), *bogie(sign * 0.55 * half, base=1.7, radius=0.36)]
        parts.append(
            box((0.3, 1.4, 0.26), (sign * (half + 0.05), 0, low + 0.05), material=Material.DARK)
        )
    start, end = -half + slant + 0.1, half - slant - 0.1
    band = wall((start, end), (low + 1.05, low + 2.0), 1.25)
    sides = panes(band, spread(int(rng.integers(5, 8)), gap=0.14), rise=(0, 1), proud=0.05)
    for x in (-0.42 * half, 0.42 * half):
        frame = wall((x - 0.65, x + 0.65), (low + 0.08, low + 2.1), 1.25)
        sides += panes(frame, [(0, 1)], rise=(0, 1), proud=0.07, material=Material.DARK)
        sides += panes(frame, spread(2, gap=0.2), rise=(0.08, 0.92), proud=0.09)
    joint = box((0.7, 2.3, top - low - 0.1), (0, 0, (top + low) / 2 + 0.02), material=Material.DARK)
    parts += [joint] if rng.random() < 0.5 else []
    roof = box((2.4, 1.6, 0.36), (0.45 * half, 0, top + 0.1))
    return [
        *parts,
        roof,
        *both_sides(sides),
        *pantograph(-0.3 * half, top, reach=1.3),
        *track(-half - 0.7, half + 0.7, sleepers=8),
    ]
