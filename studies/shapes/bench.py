"""Benches: a long seat for several people, with or without a back."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, box, cylinder, extrude, tube

STYLES = ("park", "backless", "iron", "concrete", "pew", "garden")

_SEAT_M = 0.45


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one bench in metres, sitters looking along +x, in one of `STYLES`."""
    return _BUILDERS[style](rng)


def _park(rng: np.random.Generator) -> list[Part]:
    """Return wooden slats on cast side frames with curled arms."""
    length, lean = rng.uniform(1.2, 2.3), rng.uniform(0.1, 0.26)
    parts = _seat_slats(length, 0.46, int(rng.integers(4, 6)))
    parts += _back_slats(length, -0.24, lean, int(rng.integers(3, 5)), rng.uniform(0.38, 0.48))
    inset = 0.5 * length - rng.uniform(0.08, 0.25)
    for y in (-inset, inset):
        frame = [(-0.3, y, 0.0), (-0.22, y, 0.38), (-0.24, y, 0.48), (-0.28 - lean, y, 0.92)]
        parts.append(tube(frame, 0.03, segments=6, material=Material.METAL))
        arm = [(0.26, y, 0.0), (0.2, y, 0.38), (0.24, y, 0.62), (0.1, y, 0.67), (-0.3, y, 0.66)]
        parts.append(tube(arm, 0.03, segments=6, material=Material.METAL))
        parts.append(
            cylinder((-0.24, y, 0.4), (0.22, y, 0.4), 0.03, segments=6, material=Material.METAL)
        )
    return parts


def _backless(rng: np.random.Generator) -> list[Part]:
    """Return slats on two U-shaped steel legs."""
    length, depth = rng.uniform(1.3, 2.3), rng.uniform(0.36, 0.52)
    parts = _seat_slats(length, depth, int(rng.integers(3, 6)))
    inset = length * rng.uniform(0.3, 0.42)
    half = 0.42 * depth
    for y in (-inset, inset):
        legs = [(-half - 0.03, y, 0.0), (-half, y, 0.41), (half, y, 0.41), (half + 0.03, y, 0.0)]
        parts.append(tube(legs, 0.032, segments=6, material=Material.METAL))
    parts.append(
        cylinder((0, -inset, 0.12), (0, inset, 0.12), 0.022, segments=6, material=Material.METAL)
    )
    parts += [
        box((2 * half, 0.05, 0.05), (0, y, 0.12), material=Material.METAL) for y in (-inset, inset)
    ]
    return parts


def _iron(rng: np.random.Generator) -> list[Part]:
    """Return a wrought iron bench: an arched back of bars, a plate as the seat."""
    length, arch = rng.uniform(1.1, 1.8), rng.uniform(0.02, 0.22)
    half = length / 2
    parts = [box((0.44, length, 0.045), (0, 0, _SEAT_M), chamfer=0.015)]
    across = np.linspace(-half, half, 9)
    height = 0.84 + arch * np.cos(np.pi * across / length)
    rail = np.column_stack([np.full(9, -0.33), across, height])
    parts.append(tube(rail, 0.03, segments=6))
    parts.append(cylinder((-0.24, -half, 0.55), (-0.24, half, 0.55), 0.024, segments=6))
    for y in np.linspace(-half, half, int(rng.integers(9, 14)))[1:-1]:
        top = 0.84 + arch * np.cos(np.pi * y / length)
        parts.append(box((0.025, 0.028, top - 0.46), (-0.22, y, (top + 0.46) / 2), shift=(-0.1, 0)))
    for y in (-half, half):
        parts.append(tube([(-0.3, y, 0.0), (-0.21, y, 0.45), (-0.33, y, 0.84)], 0.03, segments=6))
        arm = [
            (0.26, y, 0.0),
            (0.17, y, 0.25),
            (0.22, y, 0.45),
            (0.27, y, 0.62),
            (0.16, y, 0.68),
            (-0.27, y, 0.66),
        ]
        parts.append(tube(arm, 0.03, segments=6))
    return parts


def _concrete(rng: np.random.Generator) -> list[Part]:
    """Return a stone slab on two blocks, some with a slab of a back."""
    length, depth, thick = rng.uniform(1.4, 2.3), rng.uniform(0.42, 0.62), rng.uniform(0.09, 0.16)
    inset = length * rng.uniform(0.3, 0.4)
    leg = rng.uniform(0.12, 0.25)
    parts = [box((depth, length, thick), (0, 0, _SEAT_M - thick / 2), chamfer=0.02)]
    flare = (rng.uniform(0.7, 1.0), 1.0)
    for y in (-inset, inset):
        under = _SEAT_M - thick
        parts.append(box((0.8 * depth, leg, under), (0, y, under / 2), taper=flare))
    if rng.random() < 0.5:
        high = rng.uniform(0.3, 0.4)
        parts.append(
            box(
                (0.1, length, high),
                (-depth / 2 + 0.05, 0, _SEAT_M + high / 2),
                shift=(-0.06, 0),
                chamfer=0.02,
            )
        )
    return parts


def _pew(rng: np.random.Generator) -> list[Part]:
    """Return a church or station bench: solid back and solid ends."""
    length, height, lean = rng.uniform(1.3, 2.3), rng.uniform(0.8, 1.05), rng.uniform(0.04, 0.16)
    half = length / 2
    end = [
        (0.26, 0.0),
        (0.26, 0.62),
        (0.08, 0.66),
        (-0.16, 0.7),
        (-0.2 - lean, height + 0.04),
        (-0.3 - lean, height + 0.02),
        (-0.28, 0.0),
    ]
    parts = [extrude(end, 0.06, y=y, material=Material.WOOD) for y in (-half, half)]
    parts.append(box((0.46, length, 0.05), (0, 0, _SEAT_M)))
    parts.append(
        box((0.05, length, height - 0.4), (-0.22, 0, (height + 0.4) / 2), shift=(-lean, 0))
    )
    parts.append(box((0.03, length, 0.2), (0.18, 0, 0.34)))
    return parts


def _garden(rng: np.random.Generator) -> list[Part]:
    """Return a wooden garden bench: square posts, upright slats in the back, flat arms."""
    length, height = rng.uniform(1.1, 2.0), rng.uniform(0.84, 1.06)
    half = length / 2
    parts = _seat_slats(length, 0.48, 4)
    parts.append(box((0.05, length, 0.08), (-0.27, 0, height - 0.04)))
    parts.append(box((0.05, length, 0.06), (-0.25, 0, 0.54)))
    bars = int(rng.integers(7, 13))
    for y in np.linspace(-half, half, bars)[1:-1]:
        parts.append(
            box((0.03, 0.4 * length / bars, height - 0.58), (-0.26, y, (height + 0.5) / 2))
        )
    for y in (-half, half):
        parts.append(box((0.07, 0.07, height), (-0.25, y, height / 2)))
        parts.append(box((0.07, 0.07, 0.62), (0.22, y, 0.31)))
        parts.append(box((0.56, 0.1, 0.035), (0, y, 0.64)))
    parts.append(box((0.035, length, 0.09), (0.21, 0, 0.38), material=Material.WOOD))
    return parts


_BUILDERS = {
    "park": _park,
    "backless": _backless,
    "iron": _iron,
    "concrete": _concrete,
    "pew": _pew,
    "garden": _garden,
}


def _seat_slats(length: float, depth: float, count: int) -> list[Part]:
    pitch = depth / count
    at = pitch * (np.arange(count) - (count - 1) / 2)
    return [box((0.76 * pitch, length, 0.035), (x, 0, _SEAT_M)) for x in at]


def _back_slats(length: float, x: float, lean: float, count: int, height: float) -> list[Part]:
    pitch = height / count
    slats = []
    for z in pitch * (np.arange(count) + 0.7):
        back = x - lean * z / 0.45
        slats.append(
            box(
                (0.035, length, 0.74 * pitch),
                (back, 0, _SEAT_M + z),
                shift=(-lean * pitch / 0.45, 0),
            )
        )
    return slats
