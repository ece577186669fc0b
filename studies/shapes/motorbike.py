"""Motorbikes: two thick wheels, engine, tank, seat, fork, exhaust, and fairings."""

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
    loft,
    moved,
    ring,
    tube,
)
from studies.shapes.motorbike_parts import (
    Chassis,
    engine,
    exhaust,
    fairing,
    fork,
    front_guard,
    fuel_tank,
    handlebar,
    padded_seat,
    round_lamp,
    side_cover,
    swing_arm,
    tail_lamp,
    tube_frame,
    wheels,
    windscreen,
)
from studies.shapes.wheels import Outline, around, mudguard

STYLES = ("naked", "sport", "cruiser", "scooter", "enduro", "tourer")


_CHASSIS = {
    "naked": Chassis(1.42, 0.32, 0.31, 0.07, 0.95, 0.36, 0.8, 1.06),
    "sport": Chassis(1.38, 0.32, 0.3, 0.075, 0.9, 0.34, 0.84, 0.92),
    "cruiser": Chassis(1.72, 0.33, 0.34, 0.078, 0.96, 0.58, 0.66, 1.22),
    "scooter": Chassis(1.28, 0.22, 0.22, 0.055, 0.98, 0.22, 0.8, 1.04),
    "enduro": Chassis(1.46, 0.34, 0.36, 0.055, 1.06, 0.42, 0.94, 1.18),
    "tourer": Chassis(1.55, 0.32, 0.32, 0.075, 0.98, 0.4, 0.78, 1.1),
}


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one motorbike in metres, front along +x; `style` is one of `STYLES`."""
    chassis = _CHASSIS[style].jittered(rng)
    builders = {
        "naked": _naked,
        "sport": _sport,
        "cruiser": _cruiser,
        "scooter": _scooter,
        "enduro": _enduro,
        "tourer": _tourer,
    }
    return wheels(chassis, style, rng) + fork(chassis) + builders[style](chassis, rng)


def _naked(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, middle = chassis.seat, 0.5 * chassis.base
    tail = -0.18 + float(rng.uniform(-0.08, 0.06))
    cushion: Outline = [(tail + 0.06, seat + 0.1), (0.3, seat + 0.04), (middle - 0.02, seat + 0.03)]
    cushion += [(middle, seat - 0.06), (0.3, seat - 0.07), (tail + 0.1, seat + 0.02)]
    belly: Outline = [(middle - 0.2, 0.34), (middle + 0.34, 0.42), (middle + 0.36, 0.26)]
    belly += [(middle + 0.16, 0.18), (middle - 0.2, 0.18)]
    rear: Outline = [
        (tail, seat + 0.06),
        (0.42, seat - 0.04),
        (0.46, seat - 0.2),
        (0.1, seat - 0.1),
    ]
    return [
        *swing_arm(chassis),
        *tube_frame(chassis, 0.4),
        *engine(middle + 0.12, 0.42, twin=bool(rng.random() < 0.4)),
        fuel_tank(middle - 0.04, chassis.head_x - 0.06, seat + 0.1, rng),
        padded_seat(cushion, 0.27),
        extrude(rear, 0.24, bevel=0.03),
        *handlebar(chassis),
        *side_cover(chassis, 0.42, 0.26),
        extrude(belly, [0.3, 0.3, 0.24, 0.2, 0.24], bevel=0.03),
        *round_lamp(chassis.head_x + 0.16, chassis.head - 0.06, around(rng, 0.11, 0.12)),
        exhaust(chassis, rise=around(rng, 0.14, 0.4), length=around(rng, 0.42, 0.2)),
        front_guard(chassis, (40, 150)),
        tail_lamp(tail - 0.01, seat + 0.02),
        mudguard((0, 0, chassis.rear), chassis.rear + 0.03, 0.2, (60, 160), thickness=0.025),
    ]


def _sport(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, middle = chassis.seat, 0.48 * chassis.base
    nose, top = chassis.base - around(rng, 0.06, 0.6), chassis.head + around(rng, 0.12, 0.3)
    lift = around(rng, 0.2, 0.25)
    tail: Outline = [(-0.36, seat + lift), (-0.3, seat + lift + 0.03), (0.06, seat + 0.14)]
    tail += [(0.16, seat + 0.02), (middle, seat - 0.02), (middle, seat - 0.16), (0.1, seat - 0.08)]
    widths = [0.08, 0.1, 0.22, 0.26, 0.26, 0.26, 0.2]
    pad: Outline = [(0.12, seat + 0.06), (middle, seat + 0.03), (middle, seat - 0.04), (0.14, seat)]
    return [
        *swing_arm(chassis),
        *fairing(chassis, nose=nose, top=top, width=around(rng, 0.46, 0.06), belly=0.2),
        windscreen((nose - 0.14, top - 0.06), (chassis.head_x - 0.02, top + 0.17), 0.34),
        *engine(middle + 0.04, 0.4, twin=False, width=0.3),
        fuel_tank(middle - 0.06, chassis.head_x + 0.02, seat + 0.08, rng),
        extrude(tail, widths),
        padded_seat(pad, 0.24),
        *handlebar(chassis, reach=0.32, back=0.06),
        exhaust(chassis, rise=around(rng, 0.2, 0.4), length=0.4, radius=0.07),
        front_guard(chassis, (30, 155)),
        tail_lamp(-0.36, seat + lift - 0.02),
        mudguard((0, 0, chassis.rear), chassis.rear + 0.02, 0.18, (30, 110), thickness=0.025),
    ]


def _cruiser(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, middle = chassis.seat, 0.48 * chassis.base
    saddle: Outline = [(0.06, seat + 0.16), (0.22, seat + 0.06), (0.5, seat), (middle, seat + 0.1)]
    saddle += [(middle, seat - 0.05), (0.3, seat - 0.08), (0.02, seat + 0.06)]
    pipe = exhaust(chassis, rise=around(rng, 0.04, 0.8), length=around(rng, 0.7, 0.1), radius=0.055)
    hub, guard = (0, 0, chassis.rear), 2 * chassis.tyre + 0.08
    parts = [
        *swing_arm(chassis),
        *tube_frame(chassis, 0.6),
        *engine(middle + 0.1, 0.4, twin=True, width=0.34),
        fuel_tank(middle - 0.1, chassis.head_x - 0.06, seat + 0.2, rng),
        *side_cover(chassis, 0.52, 0.32),
        padded_seat(saddle, 0.28),
        *handlebar(chassis, reach=0.42, back=around(rng, 0.3, 0.2)),
        *round_lamp(chassis.head_x + 0.2, chassis.head - 0.08, around(rng, 0.13, 0.1)),
        pipe,
        moved(pipe, (-0.1, 0, 0.13)),
        mudguard(hub, chassis.rear + 0.025, guard, (20, 195), thickness=0.035, segments=9),
        front_guard(chassis, (20, 170)),
        tail_lamp(-chassis.rear - 0.07, chassis.rear + 0.14),
    ]
    if rng.random() < 0.6:
        rest = box((0.08, 0.24, 0.26), (-0.06, 0, seat + 0.32), material=Material.DARK)
        post = tube(
            [(-0.02, 0.1, seat), (-0.09, 0.1, seat + 0.44)],
            0.018,
            segments=5,
            material=Material.METAL,
        )
        parts += [rest, *both_sides(post)]
    if rng.random() < 0.5:
        bag = box((0.46, 0.15, 0.26), (-0.02, 0.2, seat - 0.1), chamfer=0.04)
        parts += both_sides(bag)
    return parts


_SCOOTER_REAR = (
    (-0.34, 0.58, 0.35, 0.07),
    (-0.22, 0.55, 0.8, 0.17),
    (0.02, 0.5, 1.05, 0.24),
    (0.26, 0.5, 0.95, 0.25),
    (0.42, 0.45, 0.7, 0.22),
)
"""The body below a scooter's seat: x, middle and half its height in metres, and relative width."""


def _scooter(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, base = chassis.seat, chassis.base
    floor, shin = 0.28, base - 0.3
    hump = around(rng, 0.21, 0.1)
    rear = [ring((x, 0, z), hump * w, h, segments=10, exponent=2.6) for x, z, w, h in _SCOOTER_REAR]
    shield = [
        (shin - 0.02, floor - 0.05),
        (shin + 0.1, floor),
        (chassis.head_x + 0.12, chassis.head - 0.1),
        (chassis.head_x + 0.02, chassis.head - 0.04),
    ]
    cushion: Outline = [(-0.32, seat - 0.1), (-0.28, seat), (0.1, seat - 0.03), (0.36, seat)]
    cushion += [(0.42, seat - 0.1)]
    head = (chassis.head_x + 0.02, 0, chassis.bar)
    guard = mudguard((base, 0, chassis.front), chassis.front + 0.02, 0.2, (5, 175), thickness=0.05)
    parts = [
        loft(rear),
        extrude(shield, [0.3, 0.5, 0.44, 0.3], bevel=0.03),
        box((shin - 0.25, 0.42, 0.1), ((shin + 0.35) / 2, 0, floor), chamfer=0.03),
        box((shin - 0.4, 0.32, 0.03), ((shin + 0.4) / 2, 0, floor + 0.05), material=Material.DARK),
        padded_seat(cushion, 0.3),
        ellipsoid((0.14, 0.2, 0.1), head, segments=10, rings=4),
        cylinder(
            (head[0] + 0.1, 0, head[2]),
            (head[0] + 0.16, 0, head[2]),
            0.085,
            0.07,
            material=Material.LAMP,
        ),
        guard,
        *handlebar(chassis, reach=0.34, back=0.08),
        *_scooter_engine(),
        tail_lamp(-0.35, 0.58),
        box((0.02, 0.18, 0.12), (-0.3, 0, 0.4), material=Material.LAMP),
    ]
    if rng.random() < 0.5:
        case = box((0.32, 0.36, 0.28), (-0.36, 0, seat + 0.12), chamfer=0.05)
        rack = box((0.4, 0.2, 0.04), (-0.28, 0, seat - 0.04), material=Material.METAL)
        parts += [case, rack]
    elif rng.random() < 0.6:
        parts.append(
            windscreen((head[0] + 0.1, head[2] + 0.05), (head[0] - 0.04, head[2] + 0.38), 0.42)
        )
    return parts


def _scooter_engine() -> list[Part]:
    pipe = [(0.3, -0.16, 0.24), (0.0, -0.17, 0.26), (-0.3, -0.17, 0.3)]
    return [
        box((0.4, 0.12, 0.18), (0.08, 0.15, 0.26), chamfer=0.04, material=Material.METAL),
        tube(pipe, [0.03, 0.06, 0.06], segments=7, material=Material.METAL),
    ]


def _enduro(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, middle = chassis.seat, 0.5 * chassis.base
    x, z = chassis.head_x, chassis.head
    tail: Outline = [(-0.42, seat + 0.08), (-0.4, seat + 0.12), (0.1, seat + 0.02)]
    tail += [(0.5, seat - 0.04), (0.42, seat - 0.22), (0.1, seat - 0.1)]
    cushion: Outline = [
        (-0.22, seat + 0.13),
        (middle + 0.1, seat + 0.06),
        (middle + 0.24, seat + 0.12),
    ]
    cushion += [(middle + 0.2, seat - 0.02), (-0.18, seat + 0.04)]
    shroud: Outline = [(middle + 0.02, seat - 0.02), (x + 0.08, z - 0.12), (x + 0.02, z - 0.42)]
    shroud += [(middle + 0.2, seat - 0.28)]
    silencer = tube(
        [
            (0.66 * chassis.base, -0.1, 0.6),
            (0.5, -0.17, 0.56),
            (0.3, -0.18, seat - 0.2),
            (-0.28, -0.18, seat - 0.02),
        ],
        [0.025, 0.03, 0.055, 0.055],
        segments=7,
        material=Material.METAL,
    )
    return [
        *swing_arm(chassis),
        *tube_frame(chassis, 0.4),
        *engine(middle + 0.1, 0.46, twin=False, width=0.28),
        fuel_tank(middle + 0.08, x - 0.04, seat + 0.02, rng),
        extrude(tail, [0.1, 0.12, 0.24, 0.24, 0.26, 0.2]),
        *side_cover(chassis, 0.28, 0.3),
        padded_seat(cushion, 0.22),
        *_enduro_front(chassis, rng),
        *handlebar(chassis, reach=around(rng, 0.42, 0.08), back=0.1),
        *both_sides(extrude(shroud, 0.07, y=0.2)),
        silencer,
        tail_lamp(-0.42, seat + 0.07),
    ]


def _enduro_front(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    """Return the high mudguard, and the number plate with the lamp in it."""
    x, z, base = chassis.head_x, chassis.head, chassis.base
    low, reach = 2 * chassis.front + 0.16, around(rng, 0.46, 0.12)
    beak = [(x - 0.02, low + 0.06), (base - 0.05, low + 0.08), (base + reach * 0.6, low)]
    beak += [(base - 0.05, low + 0.03), (x, low)]
    plate = box((0.06, 0.26, 0.28), (x + 0.1, 0, z + 0.02), taper=(1, 0.75), shift=(-0.06, 0))
    return [
        extrude(beak, [0.2, 0.2, 0.1, 0.18, 0.18]),
        plate,
        box((0.06, 0.14, 0.12), (x + 0.12, 0, z), material=Material.LAMP),
    ]


def _tourer(chassis: Chassis, rng: np.random.Generator) -> list[Part]:
    seat, middle = chassis.seat, 0.48 * chassis.base
    nose, top = chassis.base - 0.08, chassis.head + around(rng, 0.2, 0.2)
    cushion: Outline = [(-0.16, seat + 0.16), (0.22, seat + 0.14), (0.32, seat + 0.02)]
    cushion += [(middle, seat + 0.02), (middle, seat - 0.06), (-0.12, seat + 0.02)]
    rear: Outline = [(-0.4, seat + 0.04), (0.4, seat), (0.44, seat - 0.2), (-0.34, seat - 0.16)]
    height = around(rng, 0.36, 0.1)
    pannier = box((0.52, 0.2, height), (-0.16, 0.3, seat - 0.12), chamfer=0.05)
    case = box((0.38, 0.48, around(rng, 0.3, 0.15)), (-0.34, 0, seat + 0.24), chamfer=0.06)
    return [
        *swing_arm(chassis),
        *fairing(chassis, nose=nose, top=top, width=around(rng, 0.56, 0.06), belly=0.24),
        windscreen(
            (nose - 0.14, top - 0.05), (chassis.head_x - 0.06, top + around(rng, 0.36, 0.15)), 0.46
        ),
        *engine(middle + 0.04, 0.4, twin=False, width=0.4),
        fuel_tank(middle - 0.06, chassis.head_x, seat + 0.1, rng),
        padded_seat(cushion, 0.32),
        extrude(rear, 0.28, bevel=0.03),
        *handlebar(chassis, reach=0.4, back=0.18),
        exhaust(chassis, rise=0.06, length=0.55, radius=0.065),
        front_guard(chassis, (25, 160)),
        *both_sides(pannier),
        case,
        tail_lamp(-0.54, seat + 0.2),
        tail_lamp(-0.42, seat - 0.05),
        mudguard((0, 0, chassis.rear), chassis.rear + 0.03, 0.22, (60, 170), thickness=0.03),
    ]
