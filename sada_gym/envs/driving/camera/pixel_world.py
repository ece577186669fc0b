"""What the pixel kernels are given: a town and a weather as numbers, and colours.

Light is linear RGB.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.compiled import inlined

TONE_STEPS = 2048
TONE_WHITE = 3.0

Triple = tuple[float, float, float]
Array = npt.NDArray[np.float64]


class World(NamedTuple):
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


def tone_table() -> npt.NDArray[np.uint8]:
    """Map linear light in [0, TONE_WHITE] to bytes: exponential shoulder, then gamma 2.2."""
    mapped = 1 - np.exp(-1.3 * np.linspace(0, TONE_WHITE, TONE_STEPS))
    level: Array = 255 * (mapped / mapped[-1]) ** (1 / 2.2)
    return np.round(level).astype(np.uint8)


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


@inlined
def mix(a: Triple, b: Triple, share: float) -> Triple:
    """Mix two colours, `share` of them b."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


@inlined
def clip(value: float) -> float:
    """Clip to [0, 1]."""
    return min(max(value, 0.0), 1.0)
