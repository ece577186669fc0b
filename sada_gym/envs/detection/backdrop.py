"""The urban place around the object: ground, buildings, sky, drawn from a generator."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.model import check_keys
from sada_gym.envs.pixels import Triple

GROUNDS = {
    "asphalt": ((0.5, 0.7), (0.0, 0.2), (0.2, 0.5)),
    "paving": ((0.0, 1.0), (0.0, 0.6), (0.35, 0.85)),  # sports and play surfaces among them
    "brick": ((-0.03, 0.07), (0.3, 0.7), (0.35, 0.7)),
    "grass": ((0.2, 0.36), (0.35, 0.75), (0.3, 0.6)),
    "concrete": ((0.05, 0.17), (0.0, 0.35), (0.5, 0.9)),
}
"""The ranges of each ground's hue, saturation and value. Together they span what paint can be."""

PLAZA_RADIUS = 17.0
"""No building stands nearer to the middle than this; the camera's ring ends at 14.5."""


@dataclass(frozen=True, eq=False)
class Backdrop:
    """A place. Colours are linear RGB, lengths scene units.

    Attributes:
        ground: Index into the keys of `GROUNDS`.
        joint_colour: That of joints and road markings.
        ground_turn: Cosine and sine of the pattern's rotation; `ground_shift` is its offset.
        tile: Size of a paving stone.
        gloss: Mirror share of the ground: wet is above 0.3.
        buildings: (b, 10) boxes: centre x, y, half size x, y, height, colour (3), window pitch
            across and up.
        horizon: The sky's colour there; `zenith` is that overhead.
    """

    ground: int
    ground_colour: Triple
    joint_colour: Triple
    ground_turn: tuple[float, float]
    ground_shift: tuple[float, float]
    tile: float
    gloss: float
    buildings: npt.NDArray[np.float64]
    horizon: Triple
    zenith: Triple

    def to_dict(self) -> dict[str, Any]:
        """Return the place as numbers and lists, by the names of the attributes."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Backdrop:
        """Make the place that `to_dict` returned.

        Raises:
            UserError: If a key is missing or unknown.
        """
        check_keys("a backdrop", plain, [field.name for field in fields(cls)])
        buildings = np.asarray(plain["buildings"], np.float64).reshape(-1, 10)
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in plain.items()
        }
        return cls(**values | {"buildings": buildings})


def random_backdrop(rng: np.random.Generator) -> Backdrop:
    """Draw a place: its ground, its ring of 11 to 16 buildings and its sky."""
    ground = int(rng.integers(len(GROUNDS)))
    turn, grey, haze, joint = rng.uniform(size=4).tolist()
    name = list(GROUNDS)[ground]
    return Backdrop(
        ground=ground,
        ground_colour=_hsv(*(rng.uniform(*span) for span in GROUNDS[name])),
        joint_colour=(0.5, 0.5, 0.5) if joint < 0.5 else (0.06, 0.06, 0.06),
        ground_turn=(math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)),
        ground_shift=(rng.uniform(-4, 4), rng.uniform(-4, 4)),
        tile=rng.uniform(0.8, 1.8),
        gloss=rng.beta(1, 3) * (0.15 if name == "grass" else 0.6),
        buildings=_ring_of_buildings(rng),
        horizon=_hsv(0.57, 0.02 + 0.1 * haze, 0.8 + 0.15 * haze),
        zenith=_hsv(0.6, 0.65 * (1 - grey), 0.7 + 0.15 * grey),
    )


def _hsv(hue: float, saturation: float, value: float) -> Triple:
    red, green, blue = colorsys.hsv_to_rgb(hue % 1.0, saturation, value)
    return red**2.2, green**2.2, blue**2.2


def _ring_of_buildings(rng: np.random.Generator) -> npt.NDArray[np.float64]:
    count = int(rng.integers(11, 17))
    slot = 2 * math.pi / count
    angles = slot * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) + rng.uniform(0, slot)
    half = rng.uniform(2.0, 4.5, (count, 2))
    radii = PLAZA_RADIUS + 1.42 * half.max(1) + rng.uniform(0, 6, count)
    buildings = np.empty((count, 10))
    # NumPy's own sine and cosine differ from processor to processor
    buildings[:, 0] = radii * [math.cos(angle) for angle in angles.tolist()]
    buildings[:, 1] = radii * [math.sin(angle) for angle in angles.tolist()]
    buildings[:, 2:4] = half
    buildings[:, 4] = rng.uniform(3.5, 14, count)
    for i in range(count):
        buildings[i, 5:8] = _hsv(rng.uniform(), 0.5 * rng.beta(1.2, 2), rng.uniform(0.35, 0.95))
    buildings[:, 8:10] = rng.uniform([1.1, 1.3], [2.2, 2.0], (count, 2))
    return buildings
