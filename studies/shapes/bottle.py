"""Bottles: wine, beer, water, soda, jug with a handle, and spray."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import Part, cylinder, extrude, lathe, scaled, tube

STYLES = ("wine", "beer", "water", "soda", "jug", "spray")

_SEGMENTS = 16


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one bottle in metres, any handle towards -x, in one of `STYLES`."""
    return _BUILDERS[style](rng)


def _wine(rng: np.random.Generator) -> list[Part]:
    """Return a bottle with high shoulders or, about every second time, sloping ones."""
    radius, height = rng.uniform(0.034, 0.048), rng.uniform(0.27, 0.34)
    neck = rng.uniform(0.0125, 0.0165)
    shoulder = rng.uniform(0.56, 0.66) * height
    if rng.random() < 0.5:
        slope = [
            (0.97 * radius, shoulder + 0.012),
            (0.75 * radius, shoulder + 0.03),
            (neck, shoulder + 0.05),
        ]
    else:
        shoulder -= 0.05
        slope = [
            (0.85 * radius, shoulder + 0.035),
            (0.55 * radius, shoulder + 0.07),
            (neck, shoulder + 0.11),
        ]
    parts = [
        _body([(0.9 * radius, 0), (radius, 0.006), (radius, shoulder), *slope, (neck, height)])
    ]
    parts.append(
        _band(
            neck + 0.002,
            rng.uniform(0.78, 0.92) * height,
            height + 0.002,
            _one_of(rng, Material.DARK, Material.METAL, Material.WOOD),
        )
    )
    low = rng.uniform(0.08, 0.2) * height
    parts.append(
        _band(radius, low, low + rng.uniform(0.35, 0.75) * (shoulder - low), Material.LAMP)
    )
    return parts


def _beer(rng: np.random.Generator) -> list[Part]:
    radius, height = rng.uniform(0.029, 0.037), rng.uniform(0.17, 0.25)
    neck, shoulder = rng.uniform(0.012, 0.0145), rng.uniform(0.46, 0.62) * height
    bend = [
        (0.93 * radius, shoulder + 0.01),
        (0.66 * radius, shoulder + 0.026),
        (1.25 * neck, shoulder + 0.05),
    ]
    parts = [
        _body(
            [(0.9 * radius, 0), (radius, 0.005), (radius, shoulder), *bend, (neck, 0.95 * height)]
        )
    ]
    parts.append(
        lathe(
            [(neck + 0.004, 0.95 * height), (neck + 0.0035, 0.972 * height), (neck, height)],
            segments=12,
            material=Material.METAL,
        )
    )
    parts.append(
        _band(
            radius, rng.uniform(0.06, 0.2) * height, rng.uniform(0.32, 0.46) * height, Material.LAMP
        )
    )
    if rng.random() < 0.6:
        parts.append(_band(1.3 * neck, 0.79 * height, 0.87 * height, Material.LAMP))
    return parts


def _water(rng: np.random.Generator) -> list[Part]:
    """Return a ribbed plastic bottle with a wide screw cap."""
    radius, height = rng.uniform(0.032, 0.046), rng.uniform(0.2, 0.29)
    neck, shoulder = rng.uniform(0.0135, 0.017), rng.uniform(0.69, 0.77) * height
    ribs = int(rng.integers(1, 4))
    outline = [(0.85 * radius, 0), (radius, 0.008)]
    for z in np.linspace(0.1, 0.36, ribs) * height:
        outline += [(radius, z - 0.009), (0.86 * radius, z), (radius, z + 0.009)]
    outline += [
        (radius, shoulder),
        (0.88 * radius, shoulder + 0.02),
        (0.5 * radius, shoulder + 0.038),
        (neck, shoulder + 0.045),
        (neck, 0.94 * height),
    ]
    parts = [_body(outline)]
    parts.append(_band(radius, 0.44 * height, rng.uniform(0.62, 0.68) * height, Material.LAMP))
    parts.append(
        _band(
            neck + 0.004,
            0.92 * height,
            height,
            Material.DARK if rng.random() < 0.5 else Material.LAMP,
        )
    )
    parts.append(_band(neck + 0.005, 0.875 * height, 0.895 * height, Material.METAL))
    return parts


def _soda(rng: np.random.Generator) -> list[Part]:
    """Return a contour bottle: a waist below, a bulge, a long shoulder."""
    radius, height = rng.uniform(0.028, 0.04), rng.uniform(0.19, 0.26)
    waist, low = rng.uniform(0.66, 0.84), rng.uniform(-0.03, 0.03)
    shape = [
        (0.82, 0),
        (0.95, 0.03),
        (0.98, 0.1),
        (waist, 0.25 + low),
        (waist + 0.02, 0.33 + low),
        (1.0, 0.45),
        (1.0, 0.58),
        (0.85, 0.68),
        (0.55, 0.79),
        (0.4, 0.88),
        (0.38, 0.96),
    ]
    parts = [_body([(radius * r, height * z) for r, z in shape])]
    parts.append(
        _band(
            radius,
            0.46 * height,
            0.57 * height,
            _one_of(rng, Material.LAMP, Material.LAMP, Material.DARK),
        )
    )
    parts.append(
        _band(
            0.46 * radius,
            rng.uniform(0.9, 0.945) * height,
            height,
            _one_of(rng, Material.METAL, Material.DARK, Material.LAMP),
        )
    )
    return parts


def _jug(rng: np.random.Generator) -> list[Part]:
    """Return a detergent or milk jug: rounded square, with a grip."""
    radius, height = rng.uniform(0.058, 0.08), rng.uniform(0.22, 0.31)
    flat, neck = rng.uniform(0.58, 0.9), rng.uniform(0.02, 0.029)
    shoulder = rng.uniform(0.56, 0.7) * height
    outline = [
        (0.92 * radius, 0),
        (radius, 0.01),
        (radius, shoulder),
        (0.85 * radius, shoulder + 0.025),
        (neck, 0.88 * height),
        (neck, 0.92 * height),
    ]
    parts = [scaled(_body(outline), (1.0, flat, 1.0))]
    back = radius + rng.uniform(0.012, 0.022)
    grip = [
        (-0.5 * neck, 0, 0.86 * height),
        (-0.75 * back, 0, 0.86 * height),
        (-back, 0, 0.74 * height),
        (-back, 0, 0.45 * height),
        (-0.9 * radius, 0, 0.36 * height),
    ]
    parts.append(tube(grip, 0.0105, segments=8))
    parts.append(
        _band(
            neck + 0.003,
            0.89 * height,
            height,
            Material.DARK if rng.random() < 0.5 else Material.LAMP,
        )
    )
    label = _band(radius, 0.2 * shoulder, rng.uniform(0.6, 0.85) * shoulder, Material.LAMP)
    parts.append(scaled(label, (1.0, flat, 1.0)))
    return parts


def _spray(rng: np.random.Generator) -> list[Part]:
    """Return a flat bottle under a trigger head, whose nozzle points along +x."""
    radius, height = rng.uniform(0.042, 0.056), rng.uniform(0.16, 0.23)
    flat = rng.uniform(0.58, 0.85)
    waist = rng.uniform(0.5, 0.92)
    outline = [
        (0.92 * radius, 0),
        (radius, 0.01),
        (radius, 0.55 * height),
        (waist * radius, 0.8 * height),
        (0.42 * radius, 0.95 * height),
        (0.36 * radius, height),
    ]
    parts = [scaled(_body(outline), (1.0, flat, 1.0))]
    parts.append(_band(0.47 * radius, 0.96 * height, height + 0.015, Material.LAMP))
    top = height + 0.013
    long = rng.uniform(0.05, 0.06)
    head = [
        (-0.03, top + 0.02),
        (-0.012, top),
        (0.014, top),
        (0.02, top + 0.018),
        (long, top + 0.022),
        (long, top + 0.042),
        (-0.02, top + 0.044),
    ]
    parts.append(
        extrude(
            head,
            0.024,
            bevel=0.003,
            material=_one_of(rng, Material.DARK, Material.LAMP, Material.PAINT),
        )
    )
    parts.append(
        cylinder(
            (long, 0, top + 0.032),
            (long + 0.012, 0, top + 0.032),
            0.009,
            segments=8,
            material=Material.LAMP,
        )
    )
    trigger = [(0.024, 0, top + 0.02), (0.036, 0, top - 0.005), (0.034, 0, top - 0.025)]
    parts.append(tube(trigger, 0.0055, segments=6, material=Material.METAL))
    label = _band(radius, 0.14 * height, rng.uniform(0.35, 0.5) * height, Material.LAMP)
    parts.append(scaled(label, (1.0, flat, 1.0)))
    return parts


_BUILDERS = {
    "wine": _wine,
    "beer": _beer,
    "water": _water,
    "soda": _soda,
    "jug": _jug,
    "spray": _spray,
}


def _one_of(rng: np.random.Generator, *materials: Material) -> Material:
    return materials[int(rng.integers(len(materials)))]


def _body(outline: list[tuple[float, float]]) -> Part:
    return lathe(outline, segments=_SEGMENTS)


def _band(radius: float, low: float, high: float, material: Material) -> Part:
    """Return a label or cap that stands out a little from a body of the radius."""
    r = 1.015 * radius
    return lathe(
        [(0.9 * r, low), (r, low), (r, high), (0.9 * r, high)],
        segments=_SEGMENTS,
        material=material,
    )
