"""The arguments of the pixel kernels: camera, light, place, the rasterised object, tables."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.envs.pixels import Triple

Array = npt.NDArray[Any]

# Albedo (3), reflectance at normal incidence, metal share, log2 of the gloss exponent e, and
# (e + 8) / 8. Rows follow shapes.Material; PAINT's albedo is replaced by the scene's colour.
MATERIALS = np.array(
    [
        [0.0, 0.0, 0.0, 0.16, 0.5, 6, 9],  # PAINT, semi-metallic
        [0.015, 0.015, 0.016, 0.03, 0.0, 3, 2],  # RUBBER
        [0.02, 0.03, 0.04, 0.25, 0.0, 7, 17],  # GLASS
        [0.5, 0.51, 0.53, 0.6, 0.9, 6, 9],  # METAL
        [0.85, 0.82, 0.72, 0.1, 0.0, 6, 9],  # LAMP
        [0.04, 0.04, 0.045, 0.04, 0.0, 4, 3],  # DARK
        [0.3, 0.16, 0.07, 0.04, 0.0, 4, 3],  # WOOD
    ]
)


class KernelCamera(NamedTuple):
    """A pinhole camera and the samples of its picture.

    `step` is a sample's width at depth 1. The viewing axis meets the picture at the sample
    coordinates `middle`, which run right and down from the picture's corner.
    """

    eye: Triple
    right: Triple
    up: Triple
    back: Triple
    step: float
    middle: tuple[float, float]


class Lamp(NamedTuple):
    """The main light and what it sees of the object, from afar.

    It shines along `-back`. `nearest` (l, l) is the inverse depth of the surface nearest to the
    light, 0 beside the object; `tangent` is half the view's width at depth 1.
    """

    right: Triple
    up: Triple
    back: Triple
    centre: Triple
    distance: float
    tangent: float
    nearest: Array


class KernelBackdrop(NamedTuple):
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
    """The rasterised object in a window of the picture.

    The window starts at sample (column, row); `shown` (h, w) is the face that each sample shows, -1
    beside the object; `planes` (f, PLANES) are of `zbuffer.rasterise`; `normals` (v, 3), `faces`
    (f, 3) and `materials` (f,) are the mesh's.
    """

    column: int
    row: int
    shown: Array
    planes: Array
    normals: Array
    faces: Array
    materials: Array


class Skin(NamedTuple):
    """What the faces of a textured model look like, and the glass in a window of the picture.

    Faces are sorted: those with holes begin at `cut`, those of dark glass, which casts a shadow, at
    `dark`, those of clear glass at `clear`. Face f has the surface `materials[f]`.

    Surface s has an opacity, and `textures[s]`: the first level of its texture, the one behind its
    last, equal without a texture, and whether it has holes. Each level is half as large as the one
    before: `levels` (l, 3) are its first row of `texels`, its height and width. `texels` (t, 4)
    uint8 are sRGB and how much is solid, `linear` (256,) turns sRGB into light.

    `nearest` (h, w) is the inverse depth of what `GBuffer.shown` shows, and `panes` (h, w) the face
    of glass before it, -1 where there is none.
    """

    cut: int
    dark: int
    clear: int
    faces: Array
    materials: Array
    uv: Array
    opacity: Array
    textures: Array
    levels: Array
    texels: Array
    linear: Array
    nearest: Array
    panes: Array


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


def painted(colour: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    """Set PAINT's albedo in the table of materials to an sRGB colour; no paint is pure black."""
    materials: npt.NDArray[np.float64] = MATERIALS.copy()
    materials[0, :3] = [0.02 + 0.9 * channel**2.2 for channel in colour]
    return materials
