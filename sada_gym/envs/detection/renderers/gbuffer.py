"""The arguments of the pixel kernels: camera, light, place, the rasterised object, tables."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.backdrop import linear
from sada_gym.envs.pixels import Triple

Array = npt.NDArray[Any]

# Albedo (3), reflectance at normal incidence, metal share, log2 of the gloss exponent.
# Rows follow shapes.Material; PAINT's albedo is replaced by the scene's colour.
MATERIALS = np.array(
    [
        [0.0, 0.0, 0.0, 0.16, 0.5, 6],  # PAINT, semi-metallic
        [0.015, 0.015, 0.016, 0.03, 0.0, 3],  # RUBBER
        [0.02, 0.03, 0.04, 0.25, 0.0, 7],  # GLASS
        [0.5, 0.51, 0.53, 0.6, 0.9, 6],  # METAL
        [0.85, 0.82, 0.72, 0.1, 0.0, 6],  # LAMP
        [0.04, 0.04, 0.045, 0.04, 0.0, 4],  # DARK
        [0.3, 0.16, 0.07, 0.04, 0.0, 4],  # WOOD
    ]
)


class KernelCamera(NamedTuple):
    """A pinhole camera; `step` is a pixel's width at distance 1."""

    eye: Triple
    right: Triple
    up: Triple
    back: Triple
    step: float
    offset: tuple[float, float]


class Lamp(NamedTuple):
    """The main light and the object's depth seen from it.

    `depth` (l, l) holds the coordinate along `back` of the surface nearest to the light, -inf
    beside the object; `half` is half its width at the centre.
    """

    toward: Triple
    right: Triple
    up: Triple
    back: Triple
    centre: Triple
    distance: float
    half: float
    depth: Array


class Place(NamedTuple):
    """What surrounds the object: `Backdrop` with the buildings in sight, and the ambient light."""

    ground: int
    ground_colour: Triple
    joint_colour: Triple
    ground_turn: tuple[float, float]
    ground_shift: tuple[float, float]
    tile: float
    gloss: float
    buildings: Array
    horizon: Triple
    zenith: Triple
    ambient: Triple
    noise: Array


class GBuffer(NamedTuple):
    """The rasterised object in a window of the image, in sub-pixels.

    `code` (h, w, >= 3) uint8 is octahedral normal and material, `depth` (h, w) the distance along
    the viewing axis, `seen` (h, w) bool; the window starts at pixel (column, row).
    """

    column: int
    row: int
    code: Array
    depth: Array
    seen: Array


def noise_tile(size: int = 128) -> npt.NDArray[np.float64]:
    """Make a smooth tileable texture in [-1, 1], (size, size), the same on every machine."""
    rng = np.random.default_rng(20_20)
    tile: npt.NDArray[np.float64] = np.zeros((size, size))
    for step, weight in ((16, 1.0), (8, 0.7), (4, 0.5), (2, 0.4), (1, 0.3)):
        coarse = rng.uniform(-1, 1, (size // step, size // step))
        rows = (np.arange(size) + 0.5) / step
        low = np.floor(rows).astype(int)
        share = (rows - low)[:, None]
        share = share * share * (3 - 2 * share)
        low %= size // step
        high = (low + 1) % (size // step)
        along = coarse[low] * (1 - share) + coarse[high] * share
        tile += weight * (along[:, low] * (1 - share.T) + along[:, high] * share.T)
    tile /= np.abs(tile).max()
    return tile


def painted(colour: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Set PAINT's albedo in the table of materials to an sRGB colour; no paint is pure black."""
    materials: npt.NDArray[np.float64] = MATERIALS.copy()
    materials[0, :3] = 0.02 + 0.9 * linear(colour)
    return materials
