"""Trucks: a cab apart from its load, on a ladder frame with large wheels."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, both_sides, box, cylinder, extrude
from studies.shapes.truck_loads import (
    FRAME,
    Truck,
    box_load,
    fire_load,
    flatbed_load,
    mixer_load,
    tank_load,
    tipper_load,
    trailer_load,
)
from studies.shapes.wheels import Cabin, around, axle, panes

STYLES = ("box", "flatbed", "tipper", "tanker", "semi", "fire", "mixer", "hauler")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one truck in metres, its front along +x; `style` is one of `STYLES`."""
    length = {"semi": 13.0, "hauler": 12.5, "mixer": 8.4, "tanker": 8.8, "tipper": 7.6}
    truck = Truck(
        rear=-around(rng, length.get(style, 8.2), 0.14),
        back=-around(rng, {"fire": 2.9, "semi": 2.2, "hauler": 3.7}.get(style, 1.95), 0.06),
        width=around(rng, 2.5, 0.03),
        height=around(rng, {"semi": 3.2, "hauler": 3.0}.get(style, 2.75), 0.07),
        wheel=around(rng, 0.52, 0.09),
    )
    cab = _bonneted_cab(truck) if style == "hauler" else _cab(truck)
    parts = cab + _frame(truck, semi=style in ("semi", "hauler"))
    parts += _running_gear(truck, style, rng)
    loads = {
        "box": box_load,
        "flatbed": flatbed_load,
        "tipper": tipper_load,
        "tanker": tank_load,
        "semi": trailer_load,
        "fire": fire_load,
        "mixer": mixer_load,
        "hauler": trailer_load,
    }
    return parts + loads[style](truck, rng)


def _cab(truck: Truck) -> list[Part]:
    """Return a cab over the engine: flat face, one large windscreen, a door a side."""
    top, belt, low = truck.height, 0.58 * truck.height, 0.62
    profile = [
        (truck.back, low),
        (truck.back, top),
        (-0.55, top),
        (-0.3, top - 0.12),
        (0, belt),
        (0.03, low - 0.15),
        (-0.3, low - 0.15),
        (-0.32, low + 0.05),
    ]
    shell = Cabin(
        base=(truck.back, 0.0),
        roof=(truck.back, -0.3),
        z=(belt, top - 0.12),
        width=(truck.width, truck.width),
    )
    parts = [extrude(profile, truck.width, bevel=0.1)]
    parts += panes(shell.front(), [(0.06, 0.94)], rise=(0.04, 0.94), proud=0.04)
    parts += both_sides(panes(shell.side(), [(0.34, 0.93)], rise=(0.0, 0.85), proud=0.04))
    return parts + _face(truck, belt)


def _bonneted_cab(truck: Truck) -> list[Part]:
    """Return a long-nosed cab: bonnet with a chrome grille, upright screen, stacks, sleeper."""
    top, belt, low, foot = truck.height, 1.95, 0.7, -1.55
    sleeper = [
        (truck.back, low),
        (truck.back, top + 0.25),
        (foot - 1.0, top + 0.25),
        (foot - 0.25, top - 0.2),
        (foot, belt),
        (foot, low),
    ]
    bonnet = [(foot - 0.1, 0.75), (foot - 0.1, belt), (-0.1, belt - 0.28), (0, 0.75)]
    shell = Cabin(
        base=(foot - 1.0, foot),
        roof=(foot - 1.0, foot - 0.25),
        z=(belt, top - 0.2),
        width=(truck.width, truck.width),
    )
    parts = [
        extrude(sleeper, truck.width, bevel=0.1),
        extrude(bonnet, [1.7, 1.7, 1.35, 1.35], bevel=0.12),
        box((0.12, 1.15, 0.95), (0, 0, 1.2), material=Material.METAL),
        box((0.3, 0.96 * truck.width, 0.3), (0, 0, 0.55), material=Material.METAL),
    ]
    parts += panes(shell.front(), [(0.06, 0.48), (0.52, 0.94)], rise=(0.05, 0.95), proud=0.04)
    parts += both_sides(panes(shell.side(), [(0.1, 0.9)], rise=(0.0, 0.85), proud=0.04))
    fender = box((1.4, 0.42, 0.2), (-0.85, 1.0, 1.12), taper=(0.6, 0.9))
    lamp = box((0.16, 0.3, 0.24), (-0.02, 0.86, 0.95), material=Material.LAMP)
    y = truck.width / 2 + 0.05
    stack = cylinder(
        (truck.back - 0.12, y - 0.2, 0.9),
        (truck.back - 0.12, y - 0.2, top + 0.9),
        0.11,
        segments=8,
        material=Material.METAL,
    )
    tank = cylinder(
        (truck.back + 0.2, y - 0.3, 0.7), (foot - 0.2, y - 0.3, 0.7), 0.32, material=Material.METAL
    )
    return parts + both_sides([fender, lamp, stack, tank])


def _face(truck: Truck, belt: float) -> list[Part]:
    """Return the grille, bumper, lamps, mirrors and steps of a cab over the engine."""
    half = truck.width / 2
    sides = [
        box((0.1, 0.4, 0.24), (0.06, half - 0.34, 0.72), material=Material.LAMP),
        box((0.16, 0.2, 0.62), (-0.12, half + 0.2, belt + 0.45), material=Material.DARK),
        box((0.1, 0.24, 0.08), (-0.16, half + 0.06, belt + 0.75), material=Material.DARK),
    ]
    return [
        *both_sides(sides),
        box((0.12, 0.62 * truck.width, 0.5), (0.0, 0, belt - 0.4), material=Material.DARK),
        box((0.3, 0.98 * truck.width, 0.28), (-0.06, 0, 0.5), material=Material.DARK),
        box((0.08, 0.5, 0.14), (0.1, 0, 0.5), material=Material.LAMP),
    ]


def _frame(truck: Truck, *, semi: bool) -> list[Part]:
    """Return the ladder frame, side guards and tail lamps."""
    end = truck.rear + 0.1
    depth = 0.24 if semi else 0.34
    z = FRAME + (0.2 if semi else 0.0) - depth / 2
    beams = box((-end - 0.4, 1.0, depth), (end / 2 - 0.2, 0, z), material=Material.DARK)
    half = truck.width / 2
    lamp = box((0.1, 0.3, 0.2), (truck.rear, half - 0.25, 0.85), material=Material.LAMP)
    bumper = box((0.16, 0.9 * truck.width, 0.2), (truck.rear + 0.1, 0, 0.6), material=Material.DARK)
    return [beams, bumper, *both_sides(lamp)]


def _running_gear(truck: Truck, style: str, rng: np.random.Generator) -> list[Part]:
    """Return the axles, and the mudguards over the front wheels."""
    radius, rear = truck.wheel, truck.rear
    front = {"hauler": -0.85, "fire": -1.35}.get(style, -1.25)
    spots = [front]
    if style in ("semi", "hauler"):
        drive = truck.back - 1.0
        spots += [drive] if style == "semi" else [drive, drive - 1.15]
        spots += [rear + 1.1 + 1.15 * number for number in range(2)]
    else:
        tandem = style in ("tipper", "mixer", "tanker") or rng.random() < 0.35
        spots += [rear + 1.6 + 0.55 * tandem] + ([rear + 1.0] if tandem else [])
    parts: list[Part] = []
    rim = float(rng.uniform(0.5, 0.6))
    segments = 12 if len(spots) < 4 else 10
    for number, x in enumerate(spots):
        width = 0.34 if number == 0 else 0.56
        parts += axle(x, radius, truck.width, width, segments=segments, rim=rim)
    tank = cylinder(
        (0.5 * (truck.back + rear) - 0.4, 0.95, 0.7),
        (0.5 * (truck.back + rear) + 0.6, 0.95, 0.7),
        0.28,
        segments=8,
        material=Material.METAL,
    )
    return parts if style in ("semi", "hauler", "fire") else [*parts, *both_sides(tank)]
