"""Bicycles: two spoked wheels, a frame of tubes, handlebar, saddle, cranks and chain ring."""

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
    loft,
    ring,
    tube,
)
from studies.shapes.wheels import around, mudguard, spoked_wheel

STYLES = ("city", "racing", "mountain", "cruiser", "cargo", "tandem", "bmx", "folding")


@dataclass(frozen=True)
class _Frame:
    """Joints of a bicycle in the plane y = 0, each x and z in metres.

    Attributes:
        rear: Rear hub.
        front: Front hub.
        crank: Bottom bracket.
        seat: Upper end of the seat tube.
        head: Upper end of the head tube.
        throat: Lower end of the head tube.
        saddle: Height of the saddle.
        bar: Height of the handlebar's clamp.
        radius: The wheels' radius.
        tube: Radius of the frame's tubes.
        tyre: Radius of the tyre's tube.
    """

    rear: Array
    front: Array
    crank: Array
    seat: Array
    head: Array
    throat: Array
    saddle: float
    bar: float
    radius: float
    tube: float
    tyre: float


_MEASURES = {
    "city": (0.34, 1.08, 0.54, 0.98, 1.06, 0.024, 0.025),
    "racing": (0.34, 0.98, 0.58, 1.0, 0.94, 0.024, 0.018),
    "mountain": (0.35, 1.12, 0.46, 0.96, 1.0, 0.032, 0.038),
    "cruiser": (0.34, 1.16, 0.48, 0.86, 1.06, 0.03, 0.036),
    "cargo": (0.32, 1.1, 0.52, 0.98, 1.06, 0.028, 0.028),
    "tandem": (0.34, 1.08, 0.54, 0.98, 0.98, 0.026, 0.022),
    "bmx": (0.27, 0.94, 0.3, 0.62, 0.86, 0.026, 0.034),
    "folding": (0.22, 1.0, 0.34, 0.92, 1.0, 0.03, 0.024),
}
"""Metres: wheel radius, wheelbase, seat tube, heights of saddle and bar, tube and tyre radius."""


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one bicycle in metres, its front along +x; `style` is one of `STYLES`."""
    frame = _frame(style, rng)
    parts = _wheels(frame, style, rng) + _fork(frame) + _drive(frame, frame.crank)
    if style == "tandem":
        parts += _tandem(frame)
    else:
        step_through = style in ("city", "folding", "cruiser") and rng.random() < 0.75
        parts += _main_tubes(frame, style, step_through=step_through or style == "folding")
        parts += _saddle(frame.seat, frame)
    return parts + _handlebar(frame, style) + _equipment(frame, style, rng)


def _equipment(frame: _Frame, style: str, rng: np.random.Generator) -> list[Part]:
    """Return mudguards, basket, rack, lamp, bottle and the like, some of them by chance."""
    parts: list[Part] = []
    if style not in ("racing", "mountain", "bmx"):
        parts += _guards(frame)
    if style == "cargo":
        parts += _crate(frame, rng)
    if style == "city" or (style == "cruiser" and rng.random() < 0.3):
        parts += _basket(frame, rng)
    elif style in ("cruiser", "folding", "tandem"):
        parts.append(_lamp(frame))
    if style in ("city", "cargo") or (style == "folding" and rng.random() < 0.5):
        parts += _rack(frame)
    if style in ("racing", "mountain") and rng.random() < 0.6:
        parts.append(_bottle(frame))
    if style == "racing" and rng.random() < 0.3:
        hub = np.array([frame.rear[0], 0.0, frame.rear[1]])
        parts.append(_disc(hub, frame.radius - 2 * frame.tyre))
    return parts


def _bottle(frame: _Frame) -> Part:
    """Return a bottle on the down tube."""
    down = frame.throat - frame.crank
    up = np.array([-down[1], down[0]]) / np.linalg.norm(down)
    start, end = (frame.crank + share * down + 0.065 * up for share in (0.3, 0.62))
    return _bar(start, end, 0.04, Material.LAMP)


def _disc(hub: Array, radius: float) -> Part:
    """Return a disc that closes a wheel, as time trial bicycles have."""
    side = np.array([0.0, 0.022, 0.0])
    return cylinder(hub - side, hub + side, radius, segments=16)


def _frame(style: str, rng: np.random.Generator) -> _Frame:
    radius, base, seat, saddle, bar, thick, tyre = _MEASURES[style]
    radius, base = around(rng, radius, 0.04), around(rng, base, 0.07)
    lean = np.radians(rng.uniform(69, 75))
    back = np.array([-np.cos(lean), np.sin(lean)])
    rear = np.array([0.0, radius])
    crank = np.array([around(rng, 0.44 if radius > 0.3 else 0.37), min(0.29, radius + 0.05)])
    extra = {"tandem": 0.68, "cargo": 0.5}.get(style, 0.0)
    front = np.array([base + extra, 0.8 * radius if style == "cargo" else radius])
    rake = 0.05 if style != "cruiser" else 0.1
    length = radius + (0.12 if style == "mountain" else 0.07)
    throat = front + np.array([-rake - 0.31 * length, 0.95 * length])
    rise = {"mountain": 0.12, "bmx": 0.1, "folding": 0.3}.get(style, 0.17)
    if style in ("cargo", "tandem"):
        rise = 0.2
    return _Frame(
        rear=rear,
        front=front,
        crank=crank,
        seat=crank + around(rng, seat, 0.08) * back,
        head=throat + rise * back,
        throat=throat,
        saddle=around(rng, saddle, 0.06),
        bar=around(rng, bar, 0.06),
        radius=radius,
        tube=around(rng, 1.05 * thick, 0.12),
        tyre=tyre,
    )


def _bar(start: Array, end: Array, radius: float, material: Material = Material.PAINT) -> Part:
    """Return a frame tube between two joints in the plane y = 0."""
    a, b = ((float(p[0]), 0.0, float(p[1])) for p in (start, end))
    return cylinder(a, b, radius, segments=6, material=material)


def _stay(start: Array, end: Array, radius: float, start_y: float, end_y: float) -> list[Part]:
    """Return a pair of thin tubes either side of a wheel."""
    a, b = (start[0], start_y, start[1]), (end[0], end_y, end[1])
    return both_sides(cylinder(a, b, radius, segments=5))


def _main_tubes(frame: _Frame, style: str, *, step_through: bool) -> list[Part]:
    """Return the front triangle, or the low frame of a step-through, and the rear triangle."""
    r = frame.tube
    parts = [_bar(frame.crank, frame.seat, r), _bar(frame.throat, frame.head, 1.25 * r)]
    low = frame.throat + 0.25 * (frame.head - frame.throat)
    high = frame.throat + 0.85 * (frame.head - frame.throat)
    across = frame.seat - frame.crank
    if step_through:
        knee = frame.crank + np.array([0.16, 0.08 if style != "folding" else 0.12])
        sag = [(p[0], 0.0, p[1]) for p in (low, 0.45 * low + 0.55 * knee - [0, 0.03], frame.crank)]
        parts.append(tube(sag, 1.3 * r, segments=6))
        if style != "folding":
            end = frame.crank + (0.4 if style == "city" else 0.72) * across
            bend = 0.5 * (high + end) - [0.0, 0.05]
            line = [(p[0], 0.0, p[1]) for p in (high, bend, end)]
            parts.append(tube(line, r, segments=6))
    else:
        parts.append(_bar(low, frame.crank, 1.25 * r))
        parts.append(_bar(high, frame.crank + 0.95 * across, r))
    joint = frame.crank + 0.88 * across
    return parts + _rear_triangle(frame, frame.crank, joint)


def _rear_triangle(frame: _Frame, crank: Array, joint: Array) -> list[Part]:
    wide, thin = 0.065 + frame.tyre, 0.62 * frame.tube
    parts = _stay(crank, frame.rear, thin, 0.04, wide)
    return parts + _stay(joint, frame.rear, thin, 0.03, wide)


def _fork(frame: _Frame) -> list[Part]:
    wide = frame.tyre + 0.045
    crown = frame.throat - [0.0, 0.01]
    knee = crown + 0.6 * (frame.front - crown) - [0.02, 0.0]
    points = [(crown[0], wide, crown[1]), (knee[0], wide, knee[1])]
    blade = tube([*points, (frame.front[0], wide, frame.front[1])], 0.75 * frame.tube, segments=5)
    top = box((0.05, 2 * wide + 0.03, 0.05), (crown[0], 0, crown[1]))
    return [*both_sides(blade), top]


def _wheels(frame: _Frame, style: str, rng: np.random.Generator) -> list[Part]:
    spokes = int(rng.integers(6, 9)) if style in ("racing", "bmx") else int(rng.integers(8, 11))
    parts: list[Part] = []
    for hub in (frame.rear, frame.front):
        parts += spoked_wheel(
            (hub[0], 0.0, hub[1]),
            float(hub[1]),
            tyre=frame.tyre,
            rim=0.03 if style == "racing" else 0.02,
            spokes=spokes,
            rim_material=Material.PAINT,
        )
    return parts


def _drive(frame: _Frame, crank: Array) -> list[Part]:
    """Return chain ring, chain, cranks and pedals; the chain runs on the right."""
    x, z, y = crank[0], crank[1], -0.055
    rear = frame.rear
    parts = [
        cylinder((x, y - 0.01, z), (x, y + 0.01, z), 0.1, segments=12, material=Material.METAL),
        cylinder((x, -0.09, z), (x, 0.09, z), 0.035, segments=6, material=Material.METAL),
    ]
    for offset, end in ((0.09, 0.045), (-0.09, -0.045)):
        start, stop = (x, y, z + offset), (rear[0], y, rear[1] + end)
        parts.append(cylinder(start, stop, 0.011, segments=4, material=Material.DARK))
    for side, sign in ((-0.09, 1), (0.09, -1)):
        tip = (x + sign * 0.14, side, z - sign * 0.09)
        parts.append(cylinder((x, side, z), tip, 0.016, segments=5, material=Material.METAL))
        pedal = (tip[0], side * 1.75, tip[2])
        parts.append(box((0.09, 0.1, 0.03), pedal, material=Material.DARK))
    return parts


def _saddle(seat: Array, frame: _Frame) -> list[Part]:
    """Return a seat post and a saddle that narrows forwards, above the upper end of a seat tube."""
    lift = frame.saddle - seat[1]
    top = np.array([seat[0] - 0.27 * lift, frame.saddle])
    stations = [(-0.15, 0.1, 0.035), (-0.08, 0.1, 0.04), (0.02, 0.05, 0.032), (0.15, 0.022, 0.02)]
    rings = [ring((top[0] + x, 0, top[1]), w, h, segments=8) for x, w, h in stations]
    post = _bar(seat, top, 0.017, Material.METAL)
    return [post, loft(rings, material=Material.DARK)]


def _handlebar(frame: _Frame, style: str) -> list[Part]:
    """Return stem, bar and grips in the style's manner."""
    up = (frame.head - frame.throat) / np.linalg.norm(frame.head - frame.throat)
    clamp = frame.head + up * max(0.04, frame.bar - frame.head[1])
    ahead = {"racing": 0.1, "mountain": 0.07, "tandem": 0.08}.get(style, 0.02)
    x, z = float(clamp[0] + ahead), float(clamp[1])
    parts = [_bar(frame.head, clamp, 0.02, Material.METAL), _bar(clamp, np.array([x, z]), 0.022)]
    shapes = {
        "racing": [(0, 0), (0, 0.21), (0.09, 0.22), (0.11, 0.22), (0.07, 0.22), (-0.03, 0.22)],
        "mountain": [(0, 0), (0.0, 0.1), (-0.03, 0.36)],
        "bmx": [(0, 0), (0.0, 0.08), (-0.02, 0.22), (-0.05, 0.35)],
        "cruiser": [(0, 0), (0.05, 0.14), (-0.03, 0.32), (-0.26, 0.34)],
    }
    rises = {
        "racing": [0, 0, -0.01, -0.08, -0.14, -0.15],
        "mountain": [0, 0.0, 0.03],
        "bmx": [0, 0.0, 0.18, 0.19],
        "cruiser": [0, 0.06, 0.09, 0.03],
    }
    outline = shapes.get(style, [(0, 0), (0.04, 0.12), (-0.02, 0.27), (-0.17, 0.29)])
    lift = rises.get(style, [0, 0.02, 0.03, 0.0])
    line = [(x + dx, y, z + dz) for (dx, y), dz in zip(outline, lift, strict=True)]
    painted = style in ("racing", "mountain", "bmx")
    metal = Material.DARK if painted else Material.METAL
    grip = cylinder(line[-2], line[-1], 0.022, segments=6, material=Material.DARK)
    if style in ("mountain", "bmx"):
        far = np.asarray(line[-1])
        start = far + 0.45 * (np.asarray(line[-2]) - far)
        grip = cylinder(start, far, 0.024, segments=6, material=Material.DARK)
    parts += both_sides([tube(line, 0.015, segments=5, material=metal), grip])
    if style == "bmx":
        at = (x - 0.01, 0.16, z + 0.1)
        parts.append(cylinder(at, (at[0], -at[1], at[2]), 0.014, segments=5))
    return parts


def _guards(frame: _Frame) -> list[Part]:
    """Return painted mudguards over both wheels and a chain guard."""
    width, gap = 2 * frame.tyre + 0.05, 0.018
    guards = []
    for hub, span in ((frame.rear, (48.0, 200.0)), (frame.front, (32.0, 175.0))):
        centre = (hub[0], 0.0, hub[1])
        guards.append(mudguard(centre, hub[1] + gap, width, span, thickness=0.018))
    x, z = frame.crank
    plate = [(x + 0.13, z), (x + 0.06, z + 0.12), (frame.rear[0] + 0.06, frame.rear[1] + 0.07)]
    plate += [(frame.rear[0] + 0.06, frame.rear[1] + 0.0), (x - 0.05, z - 0.02)]
    return [*guards, extrude(plate, 0.025, y=-0.085)]


def _lamp(frame: _Frame) -> Part:
    x, z = frame.throat[0] + 0.06, frame.throat[1] + 0.08
    return cylinder((x, 0, z), (x + 0.1, 0, z), 0.04, 0.06, segments=8, material=Material.LAMP)


def _basket(frame: _Frame, rng: np.random.Generator) -> list[Part]:
    """Return a wicker basket before the handlebar, and the lamp below it."""
    x, z = float(frame.head[0]) + 0.2, float(frame.head[1]) + 0.06
    high = around(rng, 0.22, 0.2)
    basket = box((0.24, 0.3, high), (x, 0, z), taper=(1.25, 1.25), material=Material.WOOD)
    hollow = box((0.24, 0.32, 0.02), (x, 0, z + high / 2), material=Material.DARK)
    return [basket, hollow, _lamp(frame)]


def _rack(frame: _Frame) -> list[Part]:
    z = 2 * frame.radius + 0.07
    end = np.array([frame.rear[0] - 0.2, z])
    top = box((0.42, 0.16, 0.03), (frame.rear[0] - 0.02, 0, z), material=Material.PAINT)
    leg = cylinder(
        (frame.rear[0], 0.08, frame.rear[1]),
        (end[0] + 0.05, 0.08, z),
        0.012,
        segments=4,
        material=Material.METAL,
    )
    lamp = box((0.04, 0.08, 0.06), (end[0] - 0.04, 0, z - 0.03), material=Material.LAMP)
    return [top, *both_sides(leg), lamp]


def _crate(frame: _Frame, rng: np.random.Generator) -> list[Part]:
    """Return a large box on a low carrier between the head tube and the front wheel."""
    length, height = around(rng, 0.62, 0.12), around(rng, 0.34, 0.12)
    x, z = frame.front[0] - 0.1, 2 * frame.radius * 0.8 + 0.07
    carrier = box((length, 0.46, 0.04), (x, 0, z), material=Material.DARK)
    crate = box((0.85 * length, 0.44, height), (x, 0, z + height / 2), taper=(1.15, 1.12))
    inside = box((0.86 * length, 0.4, 0.02), (x, 0, z + height), material=Material.WOOD)
    return [carrier, crate, inside]


def _tandem(frame: _Frame) -> list[Part]:
    """Return the long frame with two seats, the second handlebar and the second cranks."""
    r, step = frame.tube, np.array([0.66, 0.0])
    crank, seat = frame.crank + step, frame.seat + step
    across = frame.seat - frame.crank
    low = frame.throat + 0.2 * (frame.head - frame.throat)
    high = frame.throat + 0.85 * (frame.head - frame.throat)
    parts = [
        _bar(frame.throat, frame.head, 1.25 * r),
        _bar(frame.crank, frame.seat, r),
        _bar(crank, seat, r),
        _bar(frame.crank, crank, 1.2 * r),
        _bar(low, crank, 1.2 * r),
        _bar(high, frame.crank + 0.93 * across, r),
        _bar(low, frame.crank, 0.8 * r),
        *_rear_triangle(frame, frame.crank, frame.crank + 0.88 * across),
        *_saddle(frame.seat, frame),
        *_saddle(seat, frame),
        *_drive(frame, crank)[:2],
        *_drive(frame, crank)[4:],
    ]
    x, z = float(seat[0]), float(seat[1]) + 0.05
    line = [(x, 0, z), (x + 0.03, 0.12, z + 0.02), (x - 0.03, 0.26, z + 0.02), (x - 0.16, 0.27, z)]
    bars = tube(line, 0.016, segments=5, material=Material.METAL)
    return parts + both_sides(bars)
