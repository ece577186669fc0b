"""Buses: a long box with rows of windows, doors on the right, and wheels in arches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, both_sides, box, cylinder
from studies.shapes.wheels import (
    Outline,
    around,
    axle,
    hull,
    panes,
    spread,
    wall,
)


@dataclass(frozen=True)
class _Plan:
    """Measures of a bus in metres; x is a share of the length behind the front end.

    Attributes:
        length: Overall.
        width: The body's width.
        height: The roof's height, or that of the upper deck's parapet on an open top.
        rows: Lower and upper edge of each row of windows.
        axles: x of the axles.
        doors: x of the middle of each door.
        windows: Windows a row and side.
        rake: How far the windscreen's top lies behind its foot.
        bonnet: Length of the bonnet, 0 for none.
        wheel: Radius of the tyres.
    """

    length: float
    width: float
    height: float
    rows: tuple[tuple[float, float], ...]
    axles: tuple[float, ...]
    doors: tuple[float, ...]
    windows: int
    rake: float = 0.12
    bonnet: float = 0.0
    wheel: float = 0.48

    def x(self, share: float) -> float:
        """Return the x of a share of the length behind the front end."""
        return self.length * (0.5 - share)

    def jittered(self, rng: np.random.Generator) -> _Plan:
        """Return a plan whose measures are drawn around this one's."""
        return replace(
            self,
            length=around(rng, self.length, 0.13),
            width=around(rng, self.width, 0.05),
            axles=tuple(share + rng.uniform(-0.015, 0.015) for share in self.axles),
            windows=self.windows + int(rng.integers(-1, 2)),
            rake=around(rng, self.rake, 0.5),
            bonnet=around(rng, self.bonnet, 0.2),
            wheel=around(rng, self.wheel, 0.08),
        )


_PLANS = {
    "city": _Plan(10.6, 2.6, 3.05, ((1.25, 2.45),), (0.23, 0.71), (0.09, 0.5), 6),
    "double_decker": _Plan(
        9.8, 2.6, 4.3, ((1.25, 2.2), (2.85, 3.8)), (0.24, 0.74), (0.1,), 6, rake=0.2
    ),
    "coach": _Plan(11.6, 2.6, 3.5, ((1.75, 2.95),), (0.22, 0.68, 0.79), (0.08,), 6, rake=0.7),
    "school": _Plan(
        9.8, 2.5, 3.0, ((1.65, 2.45),), (0.12, 0.73), (0.24,), 8, rake=0.15, bonnet=1.75
    ),
    "minibus": _Plan(
        6.4, 2.15, 2.75, ((1.35, 2.3),), (0.17, 0.76), (0.33,), 4, 0.45, bonnet=0.75, wheel=0.4
    ),
    "open_top": _Plan(9.6, 2.6, 3.5, ((1.25, 2.2),), (0.24, 0.74), (0.1,), 6, rake=0.15),
}
STYLES = tuple(_PLANS)


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one bus in metres, its front along +x; `style` is one of `STYLES`."""
    plan = _PLANS[style].jittered(rng)
    parts = _body(plan) + _sides(plan) + _ends(plan, style) + _lamps(plan)
    rim = float(rng.uniform(0.52, 0.64))
    for share in plan.axles:
        parts += axle(plan.x(share), plan.wheel, plan.width * 1.005, 0.34, segments=12, rim=rim)
    if style == "open_top":
        parts += _open_deck(plan)
    elif style == "coach":
        parts += _luggage(plan)
    elif style == "school":
        parts += _school_trim(plan)
    if style in ("city", "coach", "minibus"):
        parts += _roof_units(plan, rng)
    return parts


def _body(plan: _Plan) -> list[Part]:
    front, rear, sill = plan.x(0), plan.x(1), 0.36
    low = plan.rows[0][0]
    face: Outline
    if plan.bonnet:
        foot = front - plan.bonnet
        nose = low + (0.06 if plan.bonnet > 1 else -0.1)
        face = [
            (foot - plan.rake - 0.1, plan.height),
            (foot - plan.rake, plan.height - 0.12),
            (foot, nose + 0.08),
            (front - 0.1, nose - 0.1),
            (front, nose - 0.3),
        ]
    else:
        face = [
            (front - plan.rake - 0.2, plan.height),
            (front - plan.rake, plan.height - 0.15),
            (front, low - 0.05),
        ]
    upper = [
        (rear, sill),
        (rear, low),
        (rear + 0.06, plan.height - 0.16),
        (rear + 0.22, plan.height),
        *face,
        (front, sill),
    ]
    body = hull(
        upper,
        [plan.x(share) for share in plan.axles],
        sill=sill,
        wheel_radius=plan.wheel,
        width=plan.width,
        bevel=0.12,
        ends=0.97,
        gap=0.09,
    )
    floor = box((0.95 * plan.length, plan.width - 0.8, 0.7), (0, 0, 0.65), material=Material.DARK)
    return [body, floor]


def _sides(plan: _Plan) -> list[Part]:
    y, rear = plan.width / 2, plan.x(1) + 0.25
    front = plan.x(0) - (plan.bonnet + 0.1 if plan.bonnet else 0.15) - plan.rake
    spans = spread(plan.windows, gap=0.12)
    parts: list[Part] = []
    for rise in plan.rows:
        face = wall((rear, front), rise, y)
        parts += both_sides(panes(face, spans, rise=(0, 1), proud=0.035))
    top = plan.rows[0][1] + 0.08
    for share in plan.doors:
        x = plan.x(share)
        frame = wall((x - 0.62, x + 0.62), (0.42, top), -y)
        parts += panes(frame, [(0, 1)], rise=(0, 1), proud=0.05, material=Material.DARK)
        leaves = spread(2, gap=0.14)
        parts += panes(frame, leaves, rise=(0.06, 0.95), proud=0.07)
    return parts


def _ends(plan: _Plan, style: str) -> list[Part]:
    front, rear, half = plan.x(0) - plan.bonnet, plan.x(1), 0.46 * plan.width
    low, high = plan.rows[0][0], plan.height - 0.15
    top = front - plan.rake
    face = np.array(
        [[front, -half, low], [front, half, low], [top, half, high], [top, -half, high]]
    )
    span = high - low
    parts: list[Part] = []
    board = (plan.rows[-1][1] + 0.02 - low) / span
    for number, (start, end) in enumerate(plan.rows):
        start = max(start, low + 0.12) if plan.bonnet else start
        rise = ((start - low) / span, min((end - low) / span, board))
        halves = [(0.02, 0.98)] if style != "school" else [(0.03, 0.485), (0.515, 0.97)]
        parts += panes(face, halves, rise=rise, proud=0.04)
        if not number and len(plan.rows) > 1:
            between = ((end + 0.12 - low) / span, (plan.rows[1][0] - 0.12 - low) / span)
            parts += panes(face, [(0.22, 0.78)], rise=between, proud=0.05, material=Material.LAMP)
    if len(plan.rows) == 1 and not plan.bonnet:
        label = (board + 0.04, board + 0.04 + 0.3 / span)
        parts += panes(face, [(0.2, 0.8)], rise=label, proud=0.05, material=Material.LAMP)
    back = np.array([[rear, -half, low], [rear, half, low], [rear + 0.06, half, high]])
    back = np.vstack([back, [rear + 0.06, -half, high]])
    for start, end in plan.rows:
        rise = ((start + 0.15 - low) / span, (end - low) / span)
        parts += panes(back, [(0.1, 0.9)], rise=rise, proud=0.04)
    return parts


def _lamps(plan: _Plan) -> list[Part]:
    front, rear, half = plan.x(0), plan.x(1), plan.width / 2
    foot = front - plan.bonnet
    z = plan.rows[0][1] - 0.25
    mirror = [
        box((0.14, 0.22, 0.48), (foot + 0.16, half + 0.16, z), material=Material.DARK),
        box((0.3, 0.1, 0.08), (foot, half + 0.06, z + 0.24), material=Material.DARK),
    ]
    parts = both_sides(
        [
            box((0.1, 0.42, 0.22), (front, half - 0.42, 0.82), material=Material.LAMP),
            box((0.1, 0.2, 0.5), (rear, half - 0.28, 0.95), material=Material.LAMP),
            *mirror,
        ]
    )
    grille = (0.08, 0.42 * plan.width, 0.3)
    return [
        *parts,
        box((0.16, 0.96 * plan.width, 0.24), (front, 0, 0.46), material=Material.DARK),
        box((0.16, 0.96 * plan.width, 0.24), (rear, 0, 0.46), material=Material.DARK),
        box(grille, (front + 0.01, 0, 0.84), material=Material.DARK),
        box(grille, (rear - 0.01, 0, 0.95), material=Material.DARK),
    ]


def _roof_units(plan: _Plan, rng: np.random.Generator) -> list[Part]:
    length = float(rng.uniform(0.14, 0.3)) * plan.length
    x = plan.x(float(rng.uniform(0.45, 0.75)))
    size = (length, 0.65 * plan.width, 0.24)
    return [box(size, (x, 0, plan.height + 0.1), chamfer=0.08)]


def _luggage(plan: _Plan) -> list[Part]:
    """Return the flaps of the hold between the axles, and a chrome line below the windows."""
    face = wall(
        (plan.x(plan.axles[1]) + 0.9, plan.x(plan.axles[0]) - 0.9), (0.5, 1.3), plan.width / 2
    )
    line = wall((plan.x(0.98), plan.x(0.02)), (1.48, 1.6), plan.width / 2)
    flaps = panes(face, spread(3, gap=0.06), rise=(0, 1), proud=0.025, material=Material.METAL)
    trim = panes(line, [(0, 1)], rise=(0, 1), proud=0.025, material=Material.METAL)
    return both_sides([*flaps, *trim])


def _school_trim(plan: _Plan) -> list[Part]:
    """Return the dark rub rails, warning lamps on the roof's edge and the bonnet's grille."""
    half, top = plan.width / 2, plan.height - 0.12
    parts: list[Part] = []
    for z in (1.02, 1.42):
        rail = wall((plan.x(0.99), plan.x(0) - plan.bonnet - 0.3), (z, z + 0.12), half)
        parts += panes(rail, [(0, 1)], rise=(0, 1), proud=0.04, material=Material.DARK)
    foot = plan.x(0) - plan.bonnet - plan.rake
    parts.append(box((0.16, 0.36, 0.2), (foot, half - 0.4, top), material=Material.LAMP))
    parts.append(box((0.16, 0.36, 0.2), (plan.x(1), half - 0.4, top), material=Material.LAMP))
    grille = box((0.1, 1.0, 0.5), (plan.x(0) + 0.01, 0, 1.05), material=Material.METAL)
    return [*both_sides(parts), grille]


def _open_deck(plan: _Plan) -> list[Part]:
    """Return the open upper deck: floor, rows of seats, and a rail above the parapet."""
    rear, front, top = plan.x(0.98), plan.x(0.04) - plan.rake, plan.height
    middle, length = (rear + front) / 2, front - rear
    parts = [box((length - 0.3, plan.width - 0.4, 0.1), (middle, 0, top), material=Material.DARK)]
    for x in np.linspace(rear + 0.9, front - 1.2, 7):
        seat = box((0.22, 0.9, 0.55), (x, 0.62, top + 0.3), shift=(-0.1, 0), material=Material.WOOD)
        parts += both_sides(seat)
    screen = box((0.1, 0.95 * plan.width, 0.7), (front, 0, top + 0.3), material=Material.GLASS)
    y, z = plan.width / 2 - 0.12, top + 0.62
    rail = [cylinder((rear, y, z), (front, y, z), 0.05, segments=6, material=Material.METAL)]
    for x in np.linspace(rear, front, 6):
        rail.append(
            cylinder((x, y, top - 0.1), (x, y, z), 0.05, segments=5, material=Material.METAL)
        )
    back = box((0.12, plan.width - 0.2, 0.5), (rear, 0, top + 0.2))
    panel = box((length, 0.1, 0.34), (middle, plan.width / 2 - 0.1, top + 0.1))
    return [*parts, screen, back, *both_sides([*rail, panel])]
