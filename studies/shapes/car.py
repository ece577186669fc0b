"""Cars: bonnet, glazed cabin, and four wheels in their arches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, both_sides, box, cylinder, slab, torus
from studies.shapes.wheels import (
    Cabin,
    around,
    axle,
    hull,
    panes,
    spread,
)


@dataclass(frozen=True)
class _Plan:
    """Proportions of a car: metres, and for x the share of the length behind the front end.

    Attributes:
        length: Overall.
        width: The body's width.
        height: The roof's height.
        belt: Height of the windows' lower edge and of the bonnet's rear end.
        nose: Height of the bonnet's front end.
        deck: Height of the rear end.
        screen: x of the windscreen's foot and top.
        roof: x of the roof's rear end.
        tail: x of the rear window's foot.
        axles: x of the front and the rear axle.
        wheel: Radius of the tyres.
        sill: Height of the body's lower edge.
        panes: Windows a side.
    """

    length: float
    width: float
    height: float
    belt: float
    nose: float
    deck: float
    screen: tuple[float, float]
    roof: float
    tail: float
    axles: tuple[float, float] = (0.18, 0.79)
    wheel: float = 0.34
    sill: float = 0.24
    panes: int = 2

    def x(self, share: float) -> float:
        """Return the x of a share of the length behind the front end."""
        return self.length * (0.5 - share)

    def jittered(self, rng: np.random.Generator) -> _Plan:
        """Return a plan whose measures are drawn around this one's."""
        foot, top = (share + rng.uniform(-0.02, 0.02) for share in self.screen)
        belt, nose = around(rng, self.belt, 0.05), around(rng, self.nose, 0.075)
        deck = around(rng, self.deck, 0.06)
        # a wheel arch that rises above bonnet or deck would cut the body's outline
        wheel = min(around(rng, self.wheel, 0.075), (min(_bonnet(belt, nose), deck) - 0.16) / 2)
        front, rear = (share + rng.uniform(-0.012, 0.012) for share in self.axles)
        return replace(
            self,
            length=around(rng, self.length, 0.075),
            width=around(rng, self.width, 0.075),
            height=around(rng, self.height, 0.075),
            belt=belt,
            nose=nose,
            deck=deck,
            wheel=wheel,
            screen=(foot, top),
            roof=self.roof + rng.uniform(-0.02, 0.02),
            axles=(front, rear),
        )


_PLANS = {
    "saloon": _Plan(4.6, 1.8, 1.45, 0.93, 0.74, 0.9, (0.28, 0.41), 0.69, 0.84),
    "hatchback": _Plan(3.8, 1.72, 1.5, 0.95, 0.74, 0.92, (0.23, 0.38), 0.86, 0.975, (0.19, 0.82)),
    "pickup": _Plan(5.2, 1.9, 1.8, 1.1, 0.98, 1.1, (0.27, 0.36), 0.56, 0.6, (0.17, 0.77), 0.4, 0.4),
    "van": _Plan(4.8, 1.9, 2.0, 1.12, 0.86, 1.0, (0.13, 0.27), 0.965, 0.99, (0.15, 0.8), panes=3),
    "estate": _Plan(4.7, 1.8, 1.5, 0.94, 0.75, 0.92, (0.27, 0.39), 0.92, 0.985, panes=3),
    "suv": _Plan(
        4.4, 1.9, 1.78, 1.12, 0.98, 1.05, (0.27, 0.36), 0.93, 0.985, (0.18, 0.81), 0.4, 0.36, 3
    ),
    "coupe": _Plan(
        4.4, 1.84, 1.28, 0.85, 0.68, 0.86, (0.33, 0.48), 0.64, 0.94, (0.18, 0.8), 0.34, 0.2, 1
    ),
    "roadster": _Plan(
        3.9, 1.74, 1.2, 0.84, 0.7, 0.8, (0.4, 0.47), 0.7, 0.72, (0.18, 0.8), 0.32, 0.2
    ),
}
STYLES = tuple(_PLANS)


def _bonnet(belt: float, nose: float) -> float:
    """Return the bonnet's height halfway to the windscreen, above the front axle."""
    return 0.35 * belt + 0.65 * nose + 0.04


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one car in metres, its front along +x; `style` is one of `STYLES`."""
    plan = _PLANS[style].jittered(rng)
    parts = _body(plan, style)
    parts += _cockpit(plan) if style == "roadster" else _cabin(plan)
    if style == "pickup":
        parts += _bed(plan)
    if style in ("suv", "estate") and rng.random() < 0.8:
        parts += _roof_rails(plan)
    if style == "coupe":
        parts += _spoiler(plan)
    rim = float(rng.uniform(0.56, 0.7))
    for share in plan.axles:
        parts += axle(plan.x(share), plan.wheel, plan.width * 1.01, 0.24, rim=rim)
    return parts + _trim(plan)


def _body(plan: _Plan, style: str) -> list[Part]:
    front, rear, low = plan.x(0), plan.x(1), plan.sill + 0.14
    bed = style == "pickup"
    deck = max(plan.sill + 0.35, 2 * plan.wheel + 0.16) if bed else plan.deck
    upper = [
        (rear + 0.12, plan.sill),
        (rear, low),
        (rear + 0.03, deck - 0.12),
        (rear + 0.1, deck),
        *([(plan.x(plan.tail) - 0.03, deck)] if bed else []),
        (plan.x(plan.tail), plan.belt),
        (plan.x(plan.screen[0]), plan.belt),
        (plan.x(0.45 * plan.screen[0]), _bonnet(plan.belt, plan.nose)),
        (front - 0.12, plan.nose),
        (front - 0.02, plan.nose - 0.14),
        (front, low),
        (front - 0.12, plan.sill),
    ]
    body = hull(
        upper,
        [plan.x(share) for share in plan.axles],
        sill=plan.sill,
        wheel_radius=plan.wheel,
        width=plan.width,
        bevel=0.07,
        ends=0.88,
    )
    inside = min(2 * plan.wheel + 0.05, plan.nose - 0.14) - plan.sill
    floor = box(
        (0.94 * plan.length, plan.width - 0.56, inside),
        (0, 0, plan.sill - 0.04 + inside / 2),
        material=Material.DARK,
    )
    return [body, floor]


def _cabin(plan: _Plan) -> list[Part]:
    cabin = Cabin(
        base=(plan.x(plan.tail), plan.x(plan.screen[0]) + 0.02),
        roof=(plan.x(plan.roof), plan.x(plan.screen[1])),
        z=(plan.belt - 0.03, plan.height - 0.04),
        width=(0.95 * plan.width, 0.76 * plan.width),
    )
    spans = spread(plan.panes, gap=0.09, start=0.07, end=0.95)
    parts = [cabin.solid(crown=0.05)]
    parts += both_sides(panes(cabin.side(), spans, rise=(0.1, 0.88)))
    parts += panes(cabin.front(), [(0.06, 0.94)], rise=(0.06, 0.92))
    return parts + panes(cabin.rear(), [(0.1, 0.9)], rise=(0.16, 0.88))


def _cockpit(plan: _Plan) -> list[Part]:
    foot, top = plan.x(plan.screen[0]), plan.x(plan.screen[1])
    rear, low = plan.x(plan.tail), plan.belt
    half, narrow = 0.43 * plan.width, 0.36 * plan.width
    corners = [(foot, half, low), (foot, -half, low)]
    corners += [(top, -narrow, plan.height), (top, narrow, plan.height)]
    parts = [
        box(
            (foot - rear - 0.1, 0.8 * plan.width, 0.1),
            ((foot + rear) / 2, 0, low - 0.01),
            material=Material.DARK,
        ),
        slab(corners, 0.05, material=Material.GLASS),
        cylinder(corners[2], corners[3], 0.035, segments=6, material=Material.METAL),
    ]
    steering = (foot - 0.32, 0.36, low + 0.08)
    parts.append(torus(steering, (1, 0, 0.4), 0.17, 0.025, segments=8, material=Material.METAL))
    seat = box(
        (0.2, 0.52, 0.36),
        (rear + 0.22, 0.37, low + 0.14),
        taper=(0.7, 0.8),
        shift=(-0.08, 0),
        material=Material.WOOD,
    )
    hood = box((0.34, 0.8 * plan.width, 0.14), (rear - 0.06, 0, low + 0.05), taper=(0.6, 0.92))
    return [*parts, *both_sides(seat), hood]


def _bed(plan: _Plan) -> list[Part]:
    start, end = plan.x(plan.tail), plan.x(1)
    low = max(plan.sill + 0.3, 2 * plan.wheel + 0.11)
    middle, height = (start + end) / 2, plan.belt - low
    y = plan.width / 2 - 0.07
    side = box((start - end - 0.04, 0.14, height), (middle, y, low + height / 2))
    tailgate = box((0.12, plan.width * 0.96, height), (end + 0.07, 0, low + height / 2))
    floor = box(
        (start - end - 0.3, plan.width - 0.3, 0.1),
        (middle, 0, low + 0.05),
        material=Material.DARK,
    )
    return [*both_sides(side), tailgate, floor]


def _roof_rails(plan: _Plan) -> list[Part]:
    front, rear = plan.x(plan.screen[1]) - 0.3, plan.x(plan.roof) + 0.2
    y, z = 0.33 * plan.width, plan.height + 0.06
    rail = cylinder((rear, y, z), (front, y, z), 0.03, segments=6, material=Material.METAL)
    return both_sides(rail)


def _spoiler(plan: _Plan) -> list[Part]:
    x, z = plan.x(0.97), plan.deck + 0.17
    blade = box((0.3, 0.8 * plan.width, 0.05), (x, 0, z))
    strut = box((0.14, 0.06, 0.2), (x + 0.03, 0.3 * plan.width, z - 0.1), material=Material.DARK)
    return [blade, *both_sides(strut)]


def _trim(plan: _Plan) -> list[Part]:
    """Return lamps, bumpers, grille, number plates and mirrors."""
    front, rear, width = plan.x(0), plan.x(1), plan.width
    low = plan.sill + 0.12
    lamp = box(
        (0.14, 0.24 * width, 0.14),
        (front - 0.03, 0.3 * width, plan.nose - 0.13),
        material=Material.LAMP,
    )
    tail_lamp = box(
        (0.12, 0.12 * width, 0.16),
        (rear + 0.04, 0.35 * width, min(plan.deck, plan.belt) - 0.16),
        material=Material.LAMP,
    )
    mirror = box(
        (0.14, 0.2, 0.13),
        (plan.x(plan.screen[0]) - 0.18, 0.5 * width + 0.06, plan.belt + 0.07),
    )
    parts = both_sides([lamp, tail_lamp, mirror])
    for x, sign in ((front, 1), (rear, -1)):
        parts += [
            box((0.2, 0.9 * width, 0.15), (x - sign * 0.05, 0, low), material=Material.DARK),
            box((0.08, 0.3, 0.12), (x + sign * 0.03, 0, low + 0.03), material=Material.LAMP),
        ]
    grille = box(
        (0.1, 0.36 * width, 0.13), (front - 0.03, 0, plan.nose - 0.17), material=Material.DARK
    )
    return [*parts, grille]
