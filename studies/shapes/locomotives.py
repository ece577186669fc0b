"""Locomotives whose bodies are built up of several volumes: steam engine, hood unit, shunter."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Part,
    both_sides,
    box,
    cylinder,
    ellipsoid,
    extrude,
    lathe,
    loft,
    tube,
)
from studies.shapes.rolling_stock import (
    RAIL,
    bogie,
    buffers,
    railing,
    track,
    wheelset,
)
from studies.shapes.wheels import Cabin, around, panes, spread, wall


def steam(rng: np.random.Generator) -> list[Part]:
    """Return a steam locomotive with three driving axles, and its tender."""
    driver, radius = around(rng, 0.8, 0.1), around(rng, 0.85, 0.08)
    boiler, deck = around(rng, 5.2, 0.16), RAIL + 1.35
    back, front = -1.2, -1.2 + boiler
    z = deck + 0.15 + radius
    parts = _boiler(back, front, z, radius, rng)
    parts += _steam_cab(back, deck, z + radius, rng)
    parts += [
        box((boiler + 3.2, 2.5, 0.16), (back + boiler / 2 - 0.5, 0, deck)),
        box(
            (boiler + 2.4, 1.1, 0.7),
            (back + boiler / 2 - 0.4, 0, deck - 0.45),
            material=Material.DARK,
        ),
        box((0.2, 2.7, 0.6), (front + 1.15, 0, deck - 0.3)),
        extrude(
            [(front + 1.2, RAIL + 0.15), (front + 1.2, deck - 0.5), (front + 1.9, RAIL + 0.15)],
            [2.3, 2.0, 0.3],
            material=Material.METAL,
        ),
    ]
    spots = [back + 0.6 + number * 2.12 * driver for number in range(3)]
    for x in spots:
        parts += wheelset(x, driver, segments=12, material=Material.PAINT)
    parts += wheelset(front + 0.55, 0.4, segments=10)
    y, rod = 0.98, RAIL + 0.75 * driver
    sides = [
        box((spots[2] - spots[0] + 0.4, 0.12, 0.16), (spots[1], y, rod), material=Material.DARK),
        cylinder((front - 0.35, 1.05, rod + 0.25), (front + 0.75, 1.05, rod + 0.25), 0.34),
        tube(
            [(spots[1], 1.05, rod), (front - 0.3, 1.05, rod + 0.25)],
            0.08,
            segments=5,
            material=Material.METAL,
        ),
    ]
    rear = _tender(back - 2.0, deck, rng)
    return [*parts, *both_sides(sides), *rear, *track(back - 6.8, front + 2.1, sleepers=11)]


def _boiler(
    back: float, front: float, z: float, radius: float, rng: np.random.Generator
) -> list[Part]:
    """Return the boiler with hoops, smokebox, chimney, domes and head lamp."""
    top, box_end = z + radius, front + 0.95
    chimney = around(rng, 0.95, 0.2)
    flare = float(rng.uniform(1.2, 2.1))
    stack = [(0.3, -0.3), (0.26, 0.55 * chimney), (0.26 * flare, chimney), (0.2, chimney)]
    parts = [
        cylinder((back, 0, z), (front, 0, z), radius, segments=14),
        cylinder(
            (front - 0.05, 0, z),
            (box_end, 0, z),
            1.04 * radius,
            segments=14,
            material=Material.DARK,
        ),
        lathe(
            [(0.72 * radius, 0.0), (0.66 * radius, 0.1), (0.15, 0.18)],
            centre=(box_end, 0, z),
            axis="x",
            material=Material.METAL,
        ),
        lathe(stack, centre=(front + 0.4, 0, top), segments=10, material=Material.DARK),
        ellipsoid((0.42, 0.4, 0.5), (front - 1.5, 0, top), segments=10, rings=4),
        ellipsoid(
            (0.36, 0.34, 0.4), (front - 3.2, 0, top), segments=10, rings=4, material=Material.METAL
        ),
        cylinder(
            (box_end - 0.1, 0, top + 0.2),
            (box_end + 0.25, 0, top + 0.2),
            0.24,
            segments=8,
            material=Material.LAMP,
        ),
    ]
    for x in np.linspace(back + 0.8, front - 0.7, 3):
        hoop = cylinder(
            (x - 0.06, 0, z), (x + 0.06, 0, z), 1.035 * radius, segments=14, material=Material.METAL
        )
        parts.append(hoop)
    return parts


def _steam_cab(back: float, deck: float, top: float, rng: np.random.Generator) -> list[Part]:
    roof = top + around(rng, 0.55, 0.25)
    x = back - 0.75
    cab = box((1.7, 2.6, roof - deck), (x, 0, (roof + deck) / 2))
    arc = np.linspace(0, np.pi, 7)
    cover = [
        np.column_stack([np.full(7, at), 1.5 * np.cos(arc), roof - 0.05 + 0.4 * np.sin(arc)])
        for at in (x - 1.3, x + 1.1)
    ]
    window = panes(
        wall((x - 0.6, x + 0.6), (roof - 1.15, roof - 0.25), 1.3),
        spread(2, gap=0.15),
        rise=(0, 1),
        proud=0.04,
    )
    front = box((0.1, 0.5, 0.6), (x + 0.86, 0.95, roof - 0.5), material=Material.GLASS)
    return [cab, loft(cover, material=Material.DARK), *both_sides([*window, front])]


def _tender(front: float, deck: float, rng: np.random.Generator) -> list[Part]:
    length, height = around(rng, 4.0, 0.18), around(rng, 1.6, 0.1)
    x = front - length / 2
    coal = [
        (x - 0.45 * length, deck + height),
        (x + 0.1, deck + height + 0.5),
        (x + 0.45 * length, deck + height),
    ]
    parts = [
        box((length, 2.6, height), (x, 0, deck + height / 2), chamfer=0.06),
        box((length + 0.3, 2.4, 0.5), (x, 0, deck - 0.15), material=Material.DARK),
        extrude(coal, [2.2, 0.8, 2.2], material=Material.DARK),
    ]
    for offset in (-0.32, 0.0, 0.32):
        parts += wheelset(x + offset * length, 0.45, segments=8)
    rim = box((length, 0.12, 0.14), (x, 1.28, deck + height), material=Material.METAL)
    return [*parts, *both_sides(rim)]


def diesel(rng: np.random.Generator) -> list[Part]:
    """Return an American hood unit: a long narrow hood, the cab near the front, railings."""
    half, deck = around(rng, 5.9, 0.13), 1.55
    top, cab_top = deck + around(rng, 2.0, 0.06), deck + around(rng, 2.55, 0.04)
    front = half - 0.35
    cab_x = front - around(rng, 2.6, 0.12)
    parts = [
        box((2 * half, 2.9, 0.3), (0, 0, deck - 0.15)),
        box(
            (cab_x + half - 1.6, 1.75, top - deck),
            ((cab_x - half - 0.2) / 2, 0, (top + deck) / 2),
            chamfer=0.14,
        ),
        box(
            (front - cab_x - 1.2, 1.75, 1.35),
            ((front + cab_x) / 2 + 0.25, 0, deck + 0.67),
            taper=(0.85, 0.8),
            shift=(-0.12, 0),
        ),
        box((2 * half - 4.5, 1.5, 0.7), (0, 0, deck - 0.5), material=Material.DARK),
    ]
    rear = -half + 0.4
    hood = wall((rear + 0.6, cab_x - 1.3), (deck + 0.5, top - 0.4), 0.875)
    sides = panes(hood, spread(5, gap=0.35), rise=(0, 1), proud=0.05, material=Material.DARK)
    sides += railing((-half + 0.1, cab_x - 1.1), 1.35, deck)
    sides += railing((cab_x + 1.1, half - 0.1), 1.35, deck)
    for x in np.linspace(rear + 1.0, cab_x - 2.2, 3):
        parts.append(
            cylinder((x, 0, top - 0.1), (x, 0, top + 0.2), 0.5, segments=10, material=Material.DARK)
        )
    tank = box((2.6, 2.3, 0.75), (0, 0, 0.95), taper=(1.06, 1.06), material=Material.METAL)
    parts += bogie(0.62 * half, base=2.6, radius=0.5) + bogie(-0.62 * half, base=2.6, radius=0.5)
    parts += buffers(half, 1) + buffers(-half, -1)
    parts += _hood_unit_cab(cab_x, deck, cab_top)
    return [*parts, tank, *both_sides(sides), *track(-half - 0.9, half + 0.9)]


def _hood_unit_cab(x: float, deck: float, top: float) -> list[Part]:
    cab = Cabin(
        base=(x - 1.0, x + 0.95), roof=(x - 1.0, x + 0.75), z=(deck, top), width=(2.85, 2.6)
    )
    return [
        cab.solid(crown=0.14),
        *both_sides(panes(cab.side(), spread(2, gap=0.2), rise=(0.5, 0.86), proud=0.05)),
        *panes(cab.front(), [(0.06, 0.46), (0.54, 0.94)], rise=(0.56, 0.88), proud=0.06),
        *panes(cab.rear(), [(0.03, 0.2), (0.8, 0.97)], rise=(0.56, 0.88), proud=0.06),
        box((0.14, 0.6, 0.3), (x + 0.8, 0, top - 0.05), material=Material.LAMP),
    ]


def shunter(rng: np.random.Generator) -> list[Part]:
    """Return a small yard engine: low bonnet in front, a tall cab behind, rods on its wheels."""
    half, deck = around(rng, 4.2, 0.13), 1.45
    hood, cab_top = deck + around(rng, 1.45, 0.08), deck + around(rng, 2.4, 0.05)
    split = -half + around(rng, 2.7, 0.1)
    parts = [
        box((2 * half, 2.8, 0.34), (0, 0, deck - 0.17)),
        box(
            (half - split - 0.35, 1.8, hood - deck),
            ((half + split - 0.35) / 2, 0, (hood + deck) / 2),
            chamfer=0.14,
        ),
        box((2 * half - 0.5, 1.2, 0.6), (0, 0, deck - 0.5), material=Material.DARK),
        *_shunter_cab((-half + 0.4, split), deck, cab_top),
        box((0.1, 1.3, 0.9), (half - 0.36, 0, deck + 0.6), material=Material.DARK),
        cylinder(
            (half - 1.5, 0, hood - 0.1),
            (half - 1.5, 0, hood + 0.5),
            0.17,
            segments=8,
            material=Material.DARK,
        ),
    ]
    vents = wall((split + 0.3, half - 0.7), (deck + 0.3, hood - 0.3), 0.9)
    sides = panes(vents, spread(4, gap=0.3), rise=(0, 1), proud=0.05, material=Material.DARK)
    spots = np.array([-0.58, 0.0, 0.58]) * half
    for x in spots:
        parts += wheelset(float(x), 0.6, segments=12, material=Material.PAINT)
    sides.append(
        box((1.16 * half + 0.4, 0.12, 0.16), (0, 0.98, RAIL + 0.45), material=Material.DARK)
    )
    sides += railing((split + 0.2, half - 0.1), 1.3, deck)
    parts += buffers(half, 1) + buffers(-half, -1)
    return [*parts, *both_sides(sides), *track(-half - 0.8, half + 0.8, sleepers=7)]


def _shunter_cab(x: tuple[float, float], deck: float, top: float) -> list[Part]:
    cab = Cabin(base=x, roof=(x[0] + 0.05, x[1] - 0.05), z=(deck, top), width=(2.7, 2.5))
    return [
        cab.solid(crown=0.2),
        *both_sides(panes(cab.side(), spread(2, gap=0.2), rise=(0.48, 0.9), proud=0.05)),
        *panes(cab.front(), [(0.05, 0.3), (0.7, 0.95)], rise=(0.5, 0.9), proud=0.06),
        *panes(cab.front(), [(0.36, 0.64)], rise=(0.68, 0.9), proud=0.06),
        *panes(cab.rear(), spread(2, gap=0.2), rise=(0.5, 0.9), proud=0.06),
    ]
