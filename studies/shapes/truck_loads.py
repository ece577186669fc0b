"""What trucks carry: boxes, beds, tippers, tanks, trailers, drums, and a fire engine's lockers."""

from __future__ import annotations

from dataclasses import dataclass

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
    ring,
    tube,
)
from studies.shapes.wheels import around, panes, spread, wall

FRAME = 0.95
"""Height of the ladder frame's upper edge, in metres."""


@dataclass(frozen=True)
class Truck:
    """The chassis: x in metres, its front bumper at x = 0.

    Attributes:
        rear: x of the load's rear end.
        back: x of the cab's rear wall.
        width: The width of cab and load.
        height: The height of the cab's roof.
        wheel: Radius of the tyres.
    """

    rear: float
    back: float
    width: float
    height: float
    wheel: float

    @property
    def start(self) -> float:
        """Return the x of the load's front end."""
        return self.back - 0.28


def box_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return a closed box with metal edges and a double door at the rear."""
    length, height = truck.start - truck.rear, around(rng, 2.45, 0.15)
    middle, low = truck.start - length / 2, FRAME + 0.02
    width = truck.width * 1.02
    parts = [
        box((length, width, height), (middle, 0, low + height / 2)),
        box(
            (0.06, 0.08, height - 0.3),
            (truck.rear - 0.03, 0, low + height / 2),
            material=Material.DARK,
        ),
    ]
    posts = np.array([truck.rear + 0.05, truck.start - 0.05])
    return [*parts, *both_sides(_edges(posts, low, height, width))]


def _edges(posts: Array, low: float, height: float, width: float) -> list[Part]:
    """Return metal rails and posts on the left wall of a box load; `posts` are their x (n,)."""
    y, middle, length = width / 2, (posts[0] + posts[-1]) / 2, np.ptp(posts) + 0.12
    rails = [
        box((length, 0.1, 0.12), (middle, y, z), material=Material.METAL)
        for z in (low + 0.06, low + height - 0.05)
    ]
    return rails + [
        box((0.12, 0.08, height), (x, y, low + height / 2), material=Material.METAL) for x in posts
    ]


def flatbed_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return an open bed with low side boards, sometimes with crates on it."""
    length = truck.start - truck.rear
    middle, low = truck.start - length / 2, FRAME + 0.1
    board = float(rng.uniform(0.45, 0.65))
    parts = [
        box((length, truck.width, 0.2), (middle, 0, low)),
        box(
            (length - 0.2, truck.width - 0.2, 0.06), (middle, 0, low + 0.11), material=Material.WOOD
        ),
        box((0.14, truck.width, 1.1), (truck.start - 0.07, 0, low + 0.6)),
        box((0.1, truck.width, board), (truck.rear + 0.05, 0, low + 0.1 + board / 2)),
    ]
    side = box((length, 0.1, board), (middle, truck.width / 2 - 0.05, low + 0.1 + board / 2))
    posts = [
        box(
            (0.12, 0.14, board + 0.2), (x, truck.width / 2, low + board / 2), material=Material.DARK
        )
        for x in np.linspace(truck.rear + 0.06, truck.start - 0.06, 5)
    ]
    parts += both_sides([side, *posts])
    if rng.random() < 0.6:
        for x in (truck.start - 0.28 * length, truck.start - 0.55 * length):
            crate = (0.2 * length, 0.6 * truck.width, around(rng, 0.9, 0.2))
            parts.append(box(crate, (x, 0, low + 0.14 + crate[2] / 2), material=Material.WOOD))
    return parts


def tipper_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return a ribbed skip full of earth, with a shield over the cab."""
    low, high = FRAME + 0.05, around(rng, 2.4, 0.1)
    rear, start, half = truck.rear, truck.start, truck.width / 2
    side = [(rear + 0.25, low), (rear - 0.05, high), (start, high), (start - 0.15, low)]
    wall_y = half - 0.06
    parts = [
        extrude(
            [*side[:1], (rear + 0.15, low + 0.3), (start - 0.1, low + 0.3), side[3]],
            truck.width - 0.1,
        ),
        extrude(
            [
                (start - 0.15, low),
                (start, high + 0.3),
                (start - 0.12, high + 0.3),
                (start - 0.3, low),
            ],
            truck.width,
        ),
        extrude(
            [(rear + 0.25, low), (rear - 0.05, high), (rear + 0.07, high), (rear + 0.37, low)],
            truck.width,
        ),
        extrude(
            [
                (start - 0.1, high + 0.28),
                (start - 0.1, high + 0.38),
                (-0.45, truck.height + 0.18),
                (-0.45, truck.height + 0.08),
            ],
            truck.width * 0.92,
        ),
    ]
    ribs = [
        box((0.14, 0.12, high - low), (x, half, (low + high) / 2), material=Material.DARK)
        for x in np.linspace(rear + 0.6, start - 0.5, 5)
    ]
    rim = box((start - rear, 0.2, 0.14), ((start + rear) / 2, half - 0.04, high))
    flank = extrude(side, 0.12, y=wall_y)
    heap = [(rear + 0.3, high - 0.4), ((rear + start) / 2, high + 0.35), (start - 0.3, high - 0.4)]
    parts.append(extrude(heap, [truck.width - 0.3, 0.5, truck.width - 0.3], material=Material.WOOD))
    return [*parts, *both_sides([*ribs, rim, flank])]


def tank_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return a tank with hoops, a walkway and hatches."""
    radius = around(rng, 1.08, 0.12)
    middle = FRAME + 0.08 + radius
    start, rear = truck.start - 0.1, truck.rear
    stations = [(rear, 0.55), (rear + 0.25, 1.0), (start - 0.25, 1.0), (start, 0.55)]
    rings = [
        ring((x, 0, middle), 1.08 * share * radius, share * radius, segments=16, exponent=2.4)
        for x, share in stations
    ]
    parts = [loft(rings)]
    for x in np.linspace(rear + 0.5, start - 0.5, 4):
        hoop = [
            ring((x + dx, 0, middle), 1.1 * radius, 1.02 * radius, segments=16, exponent=2.4)
            for dx in (-0.07, 0.07)
        ]
        parts.append(loft(hoop, material=Material.METAL))
    length = start - rear
    parts.append(
        box(
            (0.7 * length, 0.5, 0.12),
            ((start + rear) / 2, 0, middle + radius),
            material=Material.DARK,
        )
    )
    for x in np.linspace(rear + 0.25 * length, start - 0.25 * length, 3):
        parts.append(
            cylinder(
                (x, 0, middle + radius),
                (x, 0, middle + radius + 0.25),
                0.26,
                material=Material.METAL,
                segments=8,
            )
        )
    pipe = box((0.9 * length, 0.3, 0.2), ((start + rear) / 2, 0.95, FRAME + 0.02))
    return [*parts, *both_sides(pipe)]


def trailer_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return a long trailer: a box with a gap behind the cab, legs and a skirt."""
    start, rear = truck.start - 0.35, truck.rear
    height, low = around(rng, 2.6, 0.1), FRAME + 0.2
    width, length, middle = truck.width * 1.02, start - rear, (start + rear) / 2
    parts = [box((length, width, height), (middle, 0, low + height / 2))]
    count = 8 if rng.random() < 0.5 else 2
    ribs = _edges(np.linspace(rear + 0.06, start - 0.06, count), low, height, width)
    leg = box((0.2, 0.2, low), (truck.back - 3.6, 0.8, low / 2 + 0.1), material=Material.METAL)
    seam = box(
        (0.06, 0.1, height - 0.3), (rear - 0.02, 0, low + height / 2), material=Material.DARK
    )
    if truck.height > 3.1 or rng.random() < 0.5:
        roof = truck.height
        wing = [(truck.back + 0.1, roof - 0.05), (truck.back + 0.1, low + height), (-0.6, roof)]
        parts.append(extrude(wing, [0.9 * truck.width, 0.85 * truck.width, 0.8 * truck.width]))
    return [*parts, seam, *both_sides([*ribs, leg])]


def fire_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return lockers with roller shutters, a ladder on the roof, and blue-light bars."""
    low, high = 0.72, around(rng, 2.85, 0.04)
    start, rear, half = truck.back - 0.04, truck.rear, truck.width / 2
    wheels = truck.rear + 1.6
    upper = box(
        (start - rear, truck.width, high - 1.3),
        ((start + rear) / 2, 0, (high + 1.3) / 2),
        chamfer=0.08,
    )
    parts = [upper]
    for x0, x1 in ((rear, wheels - 0.7), (wheels + 0.7, start)):
        parts.append(box((x1 - x0, truck.width, 1.35 - low), ((x0 + x1) / 2, 0, (1.35 + low) / 2)))
    lockers = wall((rear, start), (1.4, high - 0.25), half)
    shutters = panes(
        lockers,
        spread(4, gap=0.14, start=0.02, end=0.98),
        rise=(0, 1),
        proud=0.04,
        material=Material.METAL,
    )
    window = panes(
        wall((truck.back + 0.1, -1.75), (0.58 * truck.height, truck.height - 0.35), half),
        [(0, 0.85)],
        rise=(0, 1),
        proud=0.04,
    )
    stripe = panes(
        wall((rear, -0.1), (1.1, 1.3), half),
        [(0.27, 1)],
        rise=(0, 1),
        proud=0.03,
        material=Material.LAMP,
    )
    lamps = box((0.4, 1.7, 0.26), (-0.85, 0, truck.height + 0.1), material=Material.LAMP)
    door = box((0.1, 1.3, 1.3), (rear - 0.02, 0, high - 0.95), material=Material.METAL)
    return [*parts, lamps, door, *both_sides([*shutters, *window, *stripe]), *_ladder(truck, high)]


def _ladder(truck: Truck, high: float) -> list[Part]:
    start = np.array([truck.rear - 0.2, 0.0, high + 0.25])
    end = np.array([-1.3, 0.0, truck.height + 0.5])
    aside = np.array([0.0, 0.4, 0.0])
    parts = both_sides(
        tube([start + aside, end + aside], 0.08, segments=5, material=Material.METAL)
    )
    for share in np.linspace(0.04, 0.96, 10):
        at = start + share * (end - start)
        parts.append(box((0.1, 0.8, 0.1), at, material=Material.METAL))
    parts.append(box((0.6, 0.9, 0.5), (truck.rear + 1.0, 0, high + 0.1), material=Material.DARK))
    return parts


def mixer_load(truck: Truck, rng: np.random.Generator) -> list[Part]:
    """Return a tilted drum with a spiral's bands, its stand, hopper and chute."""
    radius = around(rng, 1.1, 0.1)
    length = truck.start - truck.rear
    tail = np.array([truck.rear + 0.35, 0, FRAME + 0.55 + 1.3 * radius])
    nose = np.array([truck.start - 0.15, 0, FRAME + 0.2 + 0.75 * radius])
    profile = [(0.45, 0.0), (0.62, 0.14), (1.0, 0.45), (1.0, 0.72), (0.5, 1.0)]
    line = [tail + share * (nose - tail) for _, share in profile]
    parts = [tube(line, [radius * r for r, _ in profile], segments=14)]
    for share, size in ((0.12, 0.62), (0.3, 0.84), (0.46, 1.02), (0.7, 1.02), (0.86, 0.78)):
        at, step = tail + share * (nose - tail), 0.02 * (nose - tail)
        parts.append(
            cylinder(
                at - step, at + step, 1.03 * radius * size, segments=14, material=Material.METAL
            )
        )
    parts.append(
        lathe([(0.3, 0.0), (0.62, 0.7)], centre=tail + np.array([-0.3, 0, 0.3]), segments=10)
    )
    chute = np.array([tail - [0.25, 0, 0.3], [truck.rear - 0.4, 0.3, FRAME + 0.3]])
    parts.append(tube(chute, 0.22, segments=6, material=Material.METAL))
    stands = []
    for x, z in ((truck.rear + 0.9, tail[2] - 0.5), (truck.start - 0.5, nose[2])):
        stands.append(extrude([(x - 0.35, FRAME), (x, z), (x + 0.35, FRAME)], 0.14, y=0.75))
    guard = box(
        (0.5 * length, 0.5, 0.16), (truck.rear + 0.3 * length, 0.98, 2 * truck.wheel + 0.14)
    )
    return [*parts, *both_sides([*stands, guard])]
