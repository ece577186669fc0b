"""What the cameras' pixel kernels share: colours, noise, tables.

Colours are linear RGB. Inlined functions become a part of each kernel that calls them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs import hashing
from sada_gym.foundations.compiled import inlined

Triple = tuple[float, float, float]

TONE_WHITE = 3.0
"""Light that is as bright or brighter is white."""


def tone_table(steps: int, exposure: float) -> npt.NDArray[np.uint8]:
    """Map linear light in [0, TONE_WHITE] to sRGB bytes: exponential shoulder, then gamma 2.2.

    Args:
        steps: The table's length.
        exposure: How soon light saturates.
    """
    mapped = 1 - np.exp(-exposure * np.linspace(0, TONE_WHITE, steps))
    level: npt.NDArray[np.float64] = 255 * (mapped / mapped[-1]) ** (1 / 2.2)
    return np.round(level).astype(np.uint8)


def ranked(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Replace values by the share of values that are smaller, so that all shares are as frequent.

    A share of a sky of such values is clouds of exactly this cover.
    """
    # stable: the order of equal values would depend on the processor
    ranks = values.ravel().argsort(kind="stable").argsort().reshape(values.shape)
    return ranks / ranks.size


def pixel_size(field_of_view_deg: float, columns: int) -> float:
    """Return the side of a pinhole camera's pixels at a distance of 1."""
    return 2 * float(np.tan(np.deg2rad(field_of_view_deg) / 2)) / columns


splitmix = inlined(hashing.splitmix)
"""`hashing.splitmix` in kernels, of one number."""


@inlined
def uniform(state: np.uint64) -> float:
    """Turn random bits into a number in [0, 1)."""
    return float(state >> np.uint64(11)) / 9007199254740992.0


@inlined
def dot(a: Triple, b: Triple) -> float:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def scaled(a: Triple, share: float) -> Triple:
    """Return a share of a colour."""
    return share * a[0], share * a[1], share * a[2]


@inlined
def plus(a: Triple, b: Triple, share: float) -> Triple:
    """Add a share of b to a."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@inlined
def times(a: Triple, b: Triple) -> Triple:
    """Multiply two colours, channel by channel."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


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


@inlined
def periodic(texture: npt.NDArray[Any], row: float, column: float) -> float:
    """Interpolate between the nearest four texels of a periodic texture, square, 2^k a side."""
    last = texture.shape[0] - 1
    i, j = math.floor(row), math.floor(column)
    down, right = row - i, column - j
    i, j = i & last, j & last
    k, m = (i + 1) & last, (j + 1) & last
    top = texture[i, j] * (1 - right) + texture[i, m] * right
    bottom = texture[k, j] * (1 - right) + texture[k, m] * right
    value: float = top * (1 - down) + bottom * down
    return value
