"""What trains share: track, wheelsets, bogies, rounded shells, buffers and pantographs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Array,
    Part,
    both_sides,
    box,
    cylinder,
    extrude,
    lathe,
    loft,
    tube,
)

RAIL = 0.42
"""Height of the rails' top above the ground, in metres."""


_SECTION = np.array(
    [
        (-0.47, 0.0),
        (0.47, 0.0),
        (0.5, 0.12),
        (0.5, 0.74),
        (0.42, 0.9),
        (0.2, 1.0),
        (-0.2, 1.0),
        (-0.42, 0.9),
        (-0.5, 0.74),
        (-0.5, 0.12),
    ]
)
"""A coach's cross-section: y as a share of the width, z as one of the height."""

_BOGIE_FRAME = (
    (-0.75, 0.0),
    (-0.7, 0.28),
    (0.7, 0.28),
    (0.75, 0.0),
    (0.25, -0.1),
    (-0.25, -0.1),
)
"""A bogie's side: x as a share of its wheelbase, z in metres above its axles."""

Station = tuple[float, float, float, float]
"""Where a body's cross-section is given: x, width, bottom and top in metres."""


def track(rear: float, front: float, *, sleepers: int = 9) -> list[Part]:
    """Return two rails on wooden sleepers from `rear` to `front`."""
    length, middle = front - rear, (front + rear) / 2
    rail = box((length, 0.16, 0.22), (middle, 0.75, RAIL - 0.11), material=Material.METAL)
    parts = both_sides(rail)
    for x in np.linspace(rear + 0.2, front - 0.2, sleepers):
        parts.append(box((0.36, 2.7, 0.22), (x, 0, 0.11), material=Material.WOOD))
    return parts


def wheelset(
    x: float, radius: float, *, segments: int = 12, material: Material = Material.DARK
) -> list[Part]:
    """Return two flanged wheels, in relief, that stand on the rails."""
    profile = [(0.94 * radius, -0.12), (radius, 0.04), (0.82 * radius, 0.12), (0.3 * radius, 0.16)]
    wheel = lathe(
        profile, centre=(x, 0.76, RAIL + radius), axis="y", segments=segments, material=material
    )
    return both_sides(wheel)


def bogie(x: float, *, base: float = 2.3, radius: float = 0.45) -> list[Part]:
    """Return a frame with two wheelsets and their axle boxes."""
    z = RAIL + radius
    parts: list[Part] = []
    for at in (x - base / 2, x + base / 2):
        parts += wheelset(at, radius, segments=10)
    frame = extrude(
        [(x + at * base, z + rise) for at, rise in _BOGIE_FRAME],
        0.14,
        y=0.98,
        material=Material.DARK,
    )
    return [*parts, *both_sides(frame)]


def shell(stations: Sequence[Station]) -> tuple[Part, Array]:
    """Return a body over its stations, and its rings (k, 10, 3)."""
    rings = np.array(
        [
            np.column_stack(
                [np.full(10, x), width * _SECTION[:, 0], low + (top - low) * _SECTION[:, 1]]
            )
            for x, width, low, top in stations
        ]
    )
    return loft(rings), rings


def canopy(rings: Array, share: tuple[float, float]) -> Part:
    """Return a wrap-around windscreen on the shell's upper half between its stations 2 and 3."""
    upper = [
        (rings[2] + at * (rings[3] - rings[2]))[3:9] * [1.0, 1.03, 1.0] + [0.0, 0.0, 0.07]
        for at in share
    ]
    return loft(upper, material=Material.GLASS)


def buffers(x: float, sign: int) -> list[Part]:
    """Return a coupling, two buffers and the lamps above them at the end `x`."""
    z = RAIL + 0.78
    buffer = lathe(
        [(0.1, 0.0), (0.1, sign * 0.4), (0.26, sign * 0.42), (0.26, sign * 0.5)],
        centre=(x, 0.85, z),
        axis="x",
        segments=8,
        material=Material.METAL,
    )
    lamp = box((0.12, 0.3, 0.26), (x, 0.95, z + 0.55), material=Material.LAMP)
    hook = box((0.5, 0.2, 0.2), (x + 0.1 * sign, 0, z), material=Material.DARK)
    return [*both_sides([buffer, lamp]), hook]


def pantograph(x: float, top: float, *, reach: float = 1.0) -> list[Part]:
    """Return a one-armed pantograph with its contact shoe."""
    knee, head = top + 0.3 + 0.45 * reach, top + 0.35 + reach
    arm = [(x - 0.9, 0, top + 0.1), (x + 0.75 * reach, 0, knee), (x - 0.5, 0, head)]
    return [
        box((1.7, 1.2, 0.16), (x - 0.4, 0, top + 0.08), material=Material.METAL),
        tube(arm, 0.085, segments=5, material=Material.DARK),
        box((0.34, 1.8, 0.12), (x - 0.5, 0, head), material=Material.DARK),
    ]


def floor(rear: float, front: float, low: float) -> Part:
    """Return the dark underside of a body whose bottom lies at `low`."""
    return box(
        (front - rear, 2.2, 0.4), ((front + rear) / 2, 0, low - 0.05), material=Material.DARK
    )


def double_ended(front: Sequence[Station]) -> list[Station]:
    """Return the stations of a body whose rear is its front's mirror image."""
    return [(-x, width, low, top) for x, width, low, top in reversed(front)] + list(front)


def raked_face(
    foot: tuple[float, float], top: tuple[float, float], half_width: float, *, sign: float
) -> Array:
    """Return a sloping end face (4, 3), to carry panes, from the x and z of its foot and top.

    The face looks forwards for a `sign` of 1 and, mirrored, to the rear for -1.
    """
    y = half_width
    corners = [(foot[0], -y, foot[1]), (foot[0], y, foot[1]), (top[0], y, top[1])]
    return np.array([*corners, (top[0], -y, top[1])]) * [sign, sign, 1.0]


def railing(x: tuple[float, float], y: float, z: float, *, height: float = 0.95) -> list[Part]:
    """Return a handrail with four posts along one side of a walkway at `z`."""
    start, end = ((at, y, z + height) for at in x)
    posts = [
        cylinder((at, y, z), (at, y, z + height), 0.07, segments=4, material=Material.METAL)
        for at in np.linspace(*x, 4)
    ]
    return [cylinder(start, end, 0.07, segments=5, material=Material.METAL), *posts]
