"""Boats: an open or decked hull, with sails, a cabin, a wheelhouse or thwarts and oars."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sada_gym.envs.detection.shapes.model import Material
from studies.shapes.kit import (
    Part,
    Point,
    both_sides,
    box,
    cylinder,
    extrude,
    loft,
    slab,
)

STYLES = ("sailing", "speedboat", "rowing", "trawler", "ferry", "cruiser")


def build(style: str, rng: np.random.Generator) -> list[Part]:
    """Return the parts of one boat in metres, the bow along +x; `style` is one of `STYLES`."""
    return _BUILDERS[style](rng)


def _sailing(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(5.8, 9.0), rng.uniform(2.0, 2.8), rng.uniform(1.0, 1.4)
    parts = [_hull(length, beam, deck, sheer=0.25, transom=0.7)]
    cabin = rng.uniform(0.3, 0.42) * length
    parts.append(
        box(
            (cabin, 0.55 * beam, 0.55),
            (0.02 * length, 0, deck + 0.25),
            taper=(0.85, 0.85),
            chamfer=0.06,
            material=Material.LAMP,
        )
    )
    parts.append(
        box(
            (0.7 * cabin, 0.56 * beam, 0.17),
            (0.02 * length, 0, deck + 0.3),
            material=Material.GLASS,
        )
    )
    mast, top = 0.1 * length, deck + rng.uniform(0.85, 1.25) * length
    parts.append(_spar((mast, 0, deck), (mast, 0, top), 0.1, 0.07))
    boom, swing = rng.uniform(0.38, 0.52) * length, rng.uniform(-0.4, 0.4)
    foot = (mast - boom, swing * boom, deck + 1.0)
    parts.append(_spar((mast, 0, deck + 1.0), foot, 0.08))
    bulge = (mast - 0.42 * boom, 0.42 * swing * boom, deck + 0.58 * (top - deck))
    main = [
        (mast - 0.12, 0, deck + 1.1),
        (foot[0], foot[1], deck + 1.1),
        bulge,
        (mast - 0.12, 0, top - 0.1),
    ]
    parts.append(slab(main, 0.07))
    stay = 0.46 * length
    jib = [
        (stay, 0, deck + 0.5),
        (mast + 0.15, 0.12 * length * np.sign(swing), deck + 0.75),
        (mast + 0.12, 0, deck + 0.85 * (top - deck)),
    ]
    parts.append(slab(jib, 0.07, material=Material.LAMP if rng.random() < 0.5 else Material.PAINT))
    return parts


def _speedboat(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(4.4, 7.4), rng.uniform(1.8, 2.4), rng.uniform(0.8, 1.1)
    parts = [_hull(length, beam, deck, sheer=0.2, transom=0.9, fullness=3.0)]
    well = 0.42 * length
    parts.append(
        box((well, 0.68 * beam, 0.1), (-0.14 * length, 0, deck + 0.02), material=Material.DARK)
    )
    ahead = -0.14 * length + well / 2
    screen = [
        (ahead - 0.25, deck),
        (ahead + 0.3, deck),
        (ahead - 0.25, deck + 0.5),
        (ahead - 0.33, deck + 0.48),
    ]
    parts.append(
        extrude(screen, [0.8 * beam, 0.72 * beam, 0.6 * beam, 0.6 * beam], material=Material.GLASS)
    )
    for x in np.linspace(ahead - 0.9, -0.14 * length - well / 2 + 0.4, int(rng.integers(2, 4))):
        parts.append(
            box(
                (0.3, 0.6 * beam, 0.42),
                (x, 0, deck + 0.2),
                shift=(-0.08, 0),
                chamfer=0.06,
                material=Material.LAMP,
            )
        )
    stern = -length / 2
    count = 1 if rng.random() < 0.6 else 2
    for y in (0.0,) if count == 1 else (-0.3, 0.3):
        parts.append(
            box(
                (0.5, 0.38, 0.6),
                (stern - 0.22, y, deck + 0.3),
                chamfer=0.09,
                taper=(0.8, 0.85),
                material=Material.DARK,
            )
        )
        parts.append(box((0.22, 0.14, 0.9), (stern - 0.2, y, deck - 0.4), material=Material.DARK))
    return parts


def _rowing(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(3.0, 4.8), rng.uniform(1.25, 1.7), rng.uniform(0.48, 0.68)
    parts = [_open_hull(length, beam, deck)]
    for share in (-0.3, 0.02, 0.28)[: int(rng.integers(2, 4))]:
        width = 0.84 * beam * _half_beam(share + 0.5, 0.72, 2.0)
        parts.append(
            box((0.24, width, 0.05), (share * length, 0, 0.78 * deck), material=Material.WOOD)
        )
    reach, back = rng.uniform(0.9, 1.3), rng.uniform(-0.7, 0.1)
    for side in (1.0, -1.0):
        lock = np.array([0.1 * length, side * 0.48 * beam, deck + 0.06])
        out = np.array([back, side * reach, -0.32])
        parts.append(
            cylinder(lock - 0.45 * out, lock + out, 0.035, segments=6, material=Material.WOOD)
        )
        blade = lock + 1.15 * out
        parts.append(
            cylinder(lock + 0.85 * out, blade, 0.04, 0.1, segments=6, material=Material.LAMP)
        )
    return parts


def _trawler(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(8, 13), rng.uniform(3.0, 3.9), rng.uniform(1.7, 2.3)
    parts = [_hull(length, beam, deck, sheer=0.9, transom=0.75)]
    aft = rng.random() < 0.4
    house = (-0.24 if aft else 0.12) * length
    tall, deep = rng.uniform(1.9, 2.9), rng.uniform(0.18, 0.3) * length
    parts.append(
        box(
            (deep, 0.6 * beam, tall),
            (house, 0, deck + tall / 2),
            taper=(0.9, 0.92),
            material=Material.LAMP,
        )
    )
    parts.append(
        box((deep * 0.95, 0.6 * beam, 0.5), (house, 0, deck + 0.74 * tall), material=Material.GLASS)
    )
    parts.append(box((deep * 1.1, 0.66 * beam, 0.14), (house, 0, deck + tall + 0.05)))
    mast = house + (0.65 if aft else -0.65) * deep
    top = deck + tall + rng.uniform(1.6, 2.6)
    parts.append(_spar((mast, 0, deck), (mast, 0, top), 0.13, 0.09))
    boom = mast + (0.32 if aft else -0.32) * length
    parts.append(_spar((mast, 0, deck + 1.2), (boom, 0, top - 0.6), 0.1, 0.08))
    gallows = -0.46 * length if not aft else 0.3 * length
    parts += both_sides(_spar((gallows, 0.3 * beam, deck), (gallows, 0.22 * beam, deck + 1.9), 0.1))
    parts.append(box((0.2, 0.56 * beam, 0.2), (gallows, 0, deck + 1.9), material=Material.METAL))
    parts.append(box((1.1, 1.3, 0.7), (0.5 * (boom + mast), 0, deck + 0.3), material=Material.WOOD))
    return parts


def _ferry(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(18, 27), rng.uniform(5.2, 6.6), rng.uniform(2.2, 3.0)
    parts = [_hull(length, beam, deck, sheer=0.5, transom=0.85, fullness=3.0)]
    floor, x, long = deck - 0.1, -0.1 * length, rng.uniform(0.58, 0.68) * length
    for level in range(int(rng.integers(1, 4))):
        size = (long * (1 - 0.22 * level), beam * (0.8 - 0.07 * level), 2.3)
        centre = (x - 0.04 * length * level, 0, floor + 1.15)
        parts.append(
            box(
                size,
                centre,
                taper=(0.97, 1),
                material=Material.PAINT if level == 1 else Material.LAMP,
            )
        )
        parts.append(
            box(
                (0.92 * size[0], size[1] + 0.12, 0.75),
                (centre[0], 0, floor + 1.4),
                material=Material.GLASS,
            )
        )
        parts.append(box((size[0] + 0.5, size[1] + 0.4, 0.2), (centre[0], 0, floor + 2.3)))
        floor += 2.4
        bridge = centre[0] + 0.5 * size[0] - 0.08 * length
    parts.append(
        box(
            (0.11 * length, 0.62 * beam, 2.0),
            (bridge, 0, floor + 0.9),
            taper=(0.8, 0.95),
            material=Material.LAMP,
        )
    )
    parts.append(
        box(
            (0.112 * length, 0.64 * beam, 0.6),
            (bridge, 0, floor + 1.15),
            taper=(0.85, 1),
            material=Material.GLASS,
        )
    )
    funnel = x - rng.uniform(0.14, 0.24) * length
    parts.append(
        cylinder((funnel, 0, floor), (funnel - 0.5, 0, floor + rng.uniform(2.2, 3.2)), 0.95, 0.8)
    )
    parts.append(
        cylinder(
            (funnel - 0.2, 0, floor + 2.0),
            (funnel - 0.6, 0, floor + 3.3),
            0.6,
            material=Material.DARK,
        )
    )
    return parts


def _cruiser(rng: np.random.Generator) -> list[Part]:
    length, beam, deck = rng.uniform(7, 12), rng.uniform(2.6, 3.3), rng.uniform(1.3, 1.7)
    parts = [_hull(length, beam, deck, sheer=0.35, transom=0.9, fullness=3.0)]
    back, front = -0.24 * length, rng.uniform(0.2, 0.28) * length
    tall = rng.uniform(1.1, 1.35)
    rake = rng.uniform(0.9, 1.5)
    outline = [
        (back, deck - 0.1),
        (front, deck - 0.1),
        (front - rake, deck + tall),
        (back - 0.25, deck + tall),
    ]
    broad = 0.8 * beam
    parts.append(
        extrude(
            outline,
            [broad, 0.7 * broad, 0.8 * broad, 0.88 * broad],
            bevel=0.05,
            material=Material.LAMP,
        )
    )
    low, high = deck + 0.4 * tall, deck + 0.82 * tall
    band = [
        (back + 0.3, low),
        (front - 0.42 * rake, low),
        (front - 0.84 * rake, high),
        (back + 0.3, high),
    ]
    parts.append(
        extrude(
            band, [1.01 * broad, 0.8 * broad, 0.86 * broad, 0.97 * broad], material=Material.GLASS
        )
    )
    if rng.random() < 0.6:
        parts.append(
            box(
                (0.26 * length, 0.62 * beam, 0.5),
                (-0.1 * length, 0, deck + tall + 0.2),
                taper=(0.85, 0.9),
                chamfer=0.08,
            )
        )
        parts.append(
            box(
                (0.12, 0.58 * beam, 0.45),
                (0.0, 0, deck + tall + 0.62),
                shift=(-0.3, 0),
                material=Material.GLASS,
            )
        )
    arch = [
        (-0.2 * length, y * beam, deck + z)
        for y, z in ((-0.4, 0.3), (-0.36, tall + 0.75), (0.36, tall + 0.75), (0.4, 0.3))
    ]
    parts += [cylinder(a, b, 0.1, segments=6) for a, b in pairwise(arch)]
    parts.append(
        box((0.9, 0.85 * beam, 0.14), (-length / 2 - 0.35, 0, 0.45), material=Material.WOOD)
    )
    return parts


_BUILDERS = {
    "sailing": _sailing,
    "speedboat": _speedboat,
    "rowing": _rowing,
    "trawler": _trawler,
    "ferry": _ferry,
    "cruiser": _cruiser,
}


def _spar(start: Point, end: Point, radius: float, end_radius: float | None = None) -> Part:
    """Return a mast, boom or post."""
    return cylinder(start, end, radius, end_radius, segments=6, material=Material.METAL)


def _hull(
    length: float, beam: float, deck: float, *, sheer: float, transom: float, fullness: float = 2.0
) -> Part:
    """Return a decked hull; sheer lifts the bow deck, transom is the stern's share of the beam."""
    sections = []
    for t in (0.0, 0.25, 0.5, 0.7, 0.85, 0.95, 1.0):
        half = 0.5 * beam * _half_beam(t, transom, fullness)
        rise, stem = sheer * t**2, t**6
        keel = 0.75 * deck * stem
        # The stem rakes forward from the keel to the deck.
        x, rake = length * (t - 0.5), 0.1 * length * stem
        outline = [
            (0.0, keel),
            (0.62, keel + 0.16 * deck),
            (0.92, 0.45 * deck + 0.5 * keel),
            (1.0, deck + rise),
        ]
        ring = [(x - rake * (1 - z / deck), half * y, z) for y, z in outline]
        ring += [(x, -py, pz) for _, py, pz in ring[:0:-1]]
        sections.append(ring)
    return loft(np.array(sections))


def _open_hull(length: float, beam: float, deck: float) -> Part:
    """Return an open hull with a bottom and walls; only the bow and the transom are solid."""
    sections = []
    for t in (0.0, 0.03, 0.3, 0.55, 0.78, 0.92, 1.0):
        half = 0.5 * beam * _half_beam(t, 0.72, 2.0)
        top, keel = deck + 0.3 * deck * t**2, 0.55 * deck * t**5
        outer = [(0.0, keel), (0.6 * half, keel + 0.12 * deck), (half, top)]
        hollow = 0.0 < t < 0.98
        wall = 0.05
        floor = keel + 0.2 * deck if hollow else top - 0.01
        inner = [(max(half - wall, 0.3 * half), top), (0.55 * half, floor), (0.0, floor)]
        sections.append(_mirror_ring(length * (t - 0.5), outer + inner))
    return loft(np.array(sections))


def _mirror_ring(x: float, half: list[tuple[float, float]]) -> list[tuple[float, float, float]]:
    left = [(x, y, z) for y, z in half]
    return left + [(x, -y, z) for y, z in half[-2:0:-1]]


def _half_beam(t: float, transom: float, fullness: float) -> float:
    """Return the hull's width as a share of the beam; t runs from the stern, 0, to the bow, 1."""
    if t < 0.4:
        return transom + (1 - transom) * float(np.sin(np.pi * t / 0.8))
    return max(1 - float(((t - 0.4) / 0.6) ** fullness), 0.015)
