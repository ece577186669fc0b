"""What motorbikes share: chassis measures, wheels, fork, engine, tank, seat, exhaust, fairing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Part,
    both_sides,
    box,
    cylinder,
    extrude,
    loft,
    ring,
    slab,
    tube,
)
from studies.shapes.wheels import Outline, around, mudguard, spoked_wheel


@dataclass(frozen=True)
class Chassis:
    """Measures of a motorbike in metres; its rear hub lies at x = 0.

    Attributes:
        base: Wheelbase.
        rear: Radius of the rear wheel.
        front: Radius of the front wheel.
        tyre: Radius of the tyres' tube.
        head: Height of the fork's upper end.
        rake: How far the fork's upper end lies behind the front hub.
        seat: Height of the seat.
        bar: Height of the grips.
    """

    base: float
    rear: float
    front: float
    tyre: float
    head: float
    rake: float
    seat: float
    bar: float

    @property
    def head_x(self) -> float:
        """Return the x of the fork's upper end."""
        return self.base - self.rake

    def jittered(self, rng: np.random.Generator) -> Chassis:
        """Return a chassis whose measures are drawn around this one's."""
        return Chassis(
            base=around(rng, self.base, 0.08),
            rear=around(rng, self.rear, 0.06),
            front=around(rng, self.front, 0.06),
            tyre=around(rng, self.tyre, 0.16),
            head=around(rng, self.head, 0.04),
            rake=around(rng, self.rake, 0.18),
            seat=around(rng, self.seat, 0.04),
            bar=around(rng, self.bar, 0.06),
        )


def wheels(chassis: Chassis, style: str, rng: np.random.Generator) -> list[Part]:
    """Return both wheels with brake discs, on wire or on few cast spokes."""
    wire = style in ("enduro", "cruiser")
    spokes = int(rng.integers(6, 9)) if wire else int(rng.integers(3, 6))
    parts: list[Part] = []
    for x, radius in ((0.0, chassis.rear), (chassis.base, chassis.front)):
        parts += spoked_wheel(
            (x, 0.0, radius),
            radius,
            tyre=chassis.tyre,
            rim=0.034,
            spokes=spokes,
            spoke=0.013 if wire else 0.028,
            rim_material=Material.PAINT,
        )
        y = chassis.tyre + 0.03
        disc = cylinder(
            (x, y, radius), (x, y + 0.014, radius), 0.34 * radius, material=Material.METAL
        )
        parts += both_sides(disc)
    return parts


def fork(chassis: Chassis) -> list[Part]:
    """Return two fork legs with painted covers, and the clamp at their upper end."""
    y = chassis.tyre + 0.055
    low = (chassis.base, y, chassis.front)
    high = (chassis.head_x, y, chassis.head)
    middle = tuple(0.5 * (a + b) for a, b in zip(low, high, strict=True))
    leg = cylinder(low, middle, 0.036, segments=6, material=Material.METAL)
    cover = cylinder(middle, high, 0.044, segments=6)
    clamp = box((0.1, 2 * y + 0.06, 0.05), (high[0], 0, high[2]), material=Material.DARK)
    return [clamp, *both_sides([leg, cover])]


def swing_arm(chassis: Chassis) -> list[Part]:
    """Return the arms that hold the rear wheel."""
    y = chassis.tyre + 0.05
    pivot = (0.42 * chassis.base, y, chassis.rear + 0.08)
    arm = cylinder((0, y, chassis.rear), pivot, 0.036, segments=6)
    return both_sides(arm)


def handlebar(chassis: Chassis, *, reach: float = 0.36, back: float = 0.12) -> list[Part]:
    """Return handlebar, grips and mirrors."""
    x, z = chassis.head_x, chassis.head
    line = [(x, 0.05, z), (x + 0.01, 0.14, chassis.bar - 0.02), (x - back, reach, chassis.bar)]
    tip = np.asarray(line[-1])
    start = tip + 0.5 * (np.asarray(line[-2]) - tip)
    root, end = tip * [1, 0.8, 1], tip * [1, 0.95, 1] + np.array([0.06, 0, 0.14])
    return both_sides(
        [
            tube(line, 0.018, segments=5, material=Material.METAL),
            cylinder(start, tip, 0.028, segments=6, material=Material.DARK),
            cylinder(root, end, 0.014, segments=4, material=Material.DARK),
            box((0.03, 0.13, 0.08), end, material=Material.DARK),
        ]
    )


def fuel_tank(start: float, end: float, z: float, rng: np.random.Generator) -> Part:
    """Return a fuel tank from `start` to `end` along x, highest towards the front."""
    width, height = around(rng, 0.195, 0.1), around(rng, 0.165, 0.12)
    length = end - start
    stations = [
        (0.0, 0.5, 0.55, -0.05),
        (0.3, 0.8, 0.85, 0.0),
        (0.7, 1.0, 1.05, 0.04),
        (1.0, 0.5, 0.6, 0.05),
    ]
    rings = [
        ring(
            (start + at * length, 0, z + dz), wide * width, high * height, segments=10, exponent=2.8
        )
        for at, wide, high, dz in stations
    ]
    return loft(rings)


def engine(x: float, z: float, *, twin: bool, width: float = 0.36) -> list[Part]:
    """Return a crankcase and finned cylinders: one row leaning forwards, or a V of two."""
    parts = [
        box((0.46, width, 0.26), (x, 0, z), chamfer=0.06, material=Material.METAL),
        cylinder(
            (x - 0.08, -width / 2 - 0.03, z),
            (x - 0.08, width / 2 + 0.03, z),
            0.11,
            material=Material.DARK,
        ),
    ]
    leans = (-0.42, 0.42) if twin else (0.3,)
    for lean in leans:
        for step in range(3):
            up = 0.17 + 0.085 * step
            at = (x + 0.04 + up * np.sin(lean), 0, z + up * np.cos(lean))
            size = (0.2, 0.24 if twin else width * 0.92, 0.055)
            material = Material.DARK if step % 2 == 0 else Material.METAL
            parts.append(box(size, at, shift=(0.05 * lean, 0), material=material))
    return parts


def tube_frame(chassis: Chassis, seat_x: float) -> list[Part]:
    """Return painted tubes from the head to the swing arm's pivot and under the engine."""
    top = (chassis.head_x - 0.02, 0.05, chassis.head - 0.12)
    pivot = (0.42 * chassis.base, 0.15, chassis.rear + 0.08)
    spine = [top, (seat_x, 0.13, chassis.seat - 0.1), pivot]
    cradle = [top, (0.72 * chassis.base, 0.14, 0.3), (0.46 * chassis.base, 0.16, 0.24), pivot]
    return both_sides([tube(spine, 0.038, segments=6), tube(cradle, 0.032, segments=5)])


def side_cover(chassis: Chassis, x: float, size: float) -> list[Part]:
    """Return a painted triangular panel either side, below the seat."""
    z = chassis.seat - 0.08
    cover = [(x - 0.7 * size, z), (x + 0.7 * size, z + 0.02), (x + 0.35 * size, z - size)]
    return both_sides(extrude([*cover, (x, z - size)], 0.05, y=0.15))


def padded_seat(outline: Outline, width: float) -> Part:
    """Return a dark cushion from its side profile."""
    return extrude(outline, width, bevel=0.03, material=Material.DARK)


def exhaust(chassis: Chassis, *, rise: float, length: float, radius: float = 0.06) -> Part:
    """Return a header pipe and a silencer on the right side."""
    y, x = -0.2, 0.66 * chassis.base
    line = [
        (x, -0.1, 0.6),
        (x + 0.06, y, 0.34),
        (0.42 * chassis.base, y, 0.26),
        (0.25 * chassis.base, y, 0.3 + 0.2 * rise),
        (0.25 * chassis.base - length, y - 0.02, 0.3 + rise),
    ]
    return tube(line, [0.03, 0.03, 0.035, radius, radius], segments=7, material=Material.METAL)


def round_lamp(x: float, z: float, radius: float = 0.1) -> list[Part]:
    """Return a head lamp in a painted shell."""
    shell = cylinder((x - 0.1, 0, z), (x + 0.01, 0, z), 0.5 * radius, 1.08 * radius, segments=10)
    glass = cylinder(
        (x, 0, z), (x + 0.04, 0, z), radius, 0.8 * radius, segments=10, material=Material.LAMP
    )
    return [shell, glass]


def tail_lamp(x: float, z: float) -> Part:
    """Return a rear lamp."""
    return box((0.05, 0.14, 0.07), (x, 0, z), material=Material.LAMP)


def front_guard(chassis: Chassis, span: tuple[float, float]) -> Part:
    """Return the front mudguard over the angles `span`, in degrees from +x over +z."""
    hub = (chassis.base, 0, chassis.front)
    return mudguard(hub, chassis.front + 0.025, 2 * chassis.tyre + 0.06, span, thickness=0.025)


def fairing(chassis: Chassis, *, nose: float, top: float, width: float, belly: float) -> list[Part]:
    """Return the bodywork from the nose, above the front wheel, back to the engine's underside."""
    x, rear = chassis.head_x, 0.42 * chassis.base
    limit = chassis.base - chassis.front - 0.06
    profile = [
        (nose, top - 0.24),
        (nose - 0.12, top - 0.06),
        (x + 0.06, top),
        (x - 0.2, top - 0.12),
        (rear + 0.2, chassis.seat - 0.14),
        (rear, 0.5),
        (rear - 0.06, belly),
        (limit - 0.08, belly),
        (limit, chassis.front + 0.12),
        (chassis.base - 0.12, 2 * chassis.front + 0.08),
    ]
    shares = [0.5, 0.75, 0.8, 0.8, 0.85, 0.9, 0.7, 0.7, 1.0, 0.95]
    lamp = box(
        (0.1, 0.13, 0.09),
        (nose - 0.05, 0.09, top - 0.2),
        shift=(-0.06, 0.0),
        material=Material.LAMP,
    )
    return [extrude(profile, [share * width for share in shares], bevel=0.035), *both_sides(lamp)]


def windscreen(foot: tuple[float, float], top: tuple[float, float], width: float) -> Part:
    """Return a windscreen as a plate from the foot's x and z to the top's."""
    half, narrow = width / 2, 0.35 * width
    corners = [(foot[0], -half, foot[1]), (foot[0], half, foot[1])]
    corners += [(top[0], narrow, top[1]), (top[0], -narrow, top[1])]
    return slab(corners, 0.035, material=Material.GLASS)
