"""What the pixel kernels are given: a town and a weather as numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.compiled import inlined
from sada_gym.envs.pixels import Triple

Array = npt.NDArray[np.float64]


class TownArrays(NamedTuple):
    """A town for the kernels; see `Ground` and `Scenery`."""

    texels: npt.NDArray[np.uint8]
    offset: npt.NDArray[np.int64]
    shape: npt.NDArray[np.int64]
    texel_m: float
    objects: Array
    first: npt.NDArray[np.int64]
    items: npt.NDArray[np.int64]
    cells: npt.NDArray[np.int64]
    cell_m: float
    origin: Array
    clouds: npt.NDArray[np.float32]
    tone: npt.NDArray[np.uint8]
    shade_texel_m: float


class Light(NamedTuple):
    """A weather for the kernels; see `Weather`."""

    sun_x: float
    sun_y: float
    sun_z: float
    sun: Triple
    ambient: Triple
    zenith: Triple
    horizon: Triple
    cloud: Triple
    cover: float
    haze: float
    wetness: float
    rain: float


@inlined
def light_of(numbers: Array) -> Light:
    """Read a weather out of its 22 numbers, see `Weather`."""
    return Light(
        numbers[0],
        numbers[1],
        numbers[2],
        (numbers[3], numbers[4], numbers[5]),
        (numbers[6], numbers[7], numbers[8]),
        (numbers[9], numbers[10], numbers[11]),
        (numbers[12], numbers[13], numbers[14]),
        (numbers[15], numbers[16], numbers[17]),
        numbers[18],
        numbers[19],
        numbers[20],
        numbers[21],
    )
