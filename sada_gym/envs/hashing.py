"""A hash of whole numbers, for arrays and for kernels."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Bits = TypeVar("Bits", np.uint64, npt.NDArray[np.uint64])


def splitmix(state: Bits) -> Bits:
    """Take one step of SplitMix64 (Steele, Lea, Flood 2014): mix the bits of 64-bit numbers."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))
