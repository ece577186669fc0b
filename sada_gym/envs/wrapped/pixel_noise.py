"""Gaussian noise on the bytes of pictures, fast: a step of Atari's takes a third of a millisecond.

A byte with noise of standard deviation s, rounded, is the byte and a whole number d, with P(d <= k)
= Phi((k + 1/2) / s). Sixteen random bits tell d by a table, or lie in a cell that one of these
bounds divides; 53 further bits then tell the side, so that d has its distribution exactly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from sada_gym.foundations.arrays import Bytes, Floats
from sada_gym.foundations.compiled import inlined, kernel

_MOST, _CELLS, _DIVIDED = 255, 2**16, -(2**15)
_U = np.uint64
# SplitMix64 (Steele, Lea and Flood, 2014)
_STEP, _FIRST, _SECOND = _U(0x9E3779B97F4A7C15), _U(0xBF58476D1CE4E5B9), _U(0x94D049BB133111EB)
_A, _B, _C, _D = _U(30), _U(27), _U(31), _U(11)


class PixelNoise:
    """Noise of one standard deviation above 0; `rng` gives a key for each picture."""

    def __init__(self, deviation: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._bounds = ndtr((np.arange(-_MOST, _MOST) + 0.5) / deviation)
        edges = np.searchsorted(self._bounds, np.arange(_CELLS + 1) / _CELLS, side="right")
        whole = edges[:-1] == edges[1:]
        self._table = np.where(whole, edges[:-1] - _MOST, _DIVIDED).astype(np.int16)

    def __call__(self, picture: Bytes) -> Bytes:
        """Return a picture, (...) uint8, with noise, within 0 to 255."""
        pixels, noisy = np.ascontiguousarray(picture), np.empty(picture.shape, np.uint8)
        keys = self._rng.integers(2**64, size=2, dtype=np.uint64)
        words = np.empty(-(-picture.size // 4), np.uint64)
        _fill(keys[0], words)
        bits = words.view(np.uint16)
        _add(pixels.ravel(), noisy.ravel(), bits, self._table, self._bounds, keys[1])
        return noisy


@inlined
def _word(key: np.uint64, number: int) -> np.uint64:
    z = key + _U(number) * _STEP
    z = (z ^ (z >> _A)) * _FIRST
    z = (z ^ (z >> _B)) * _SECOND
    return z ^ (z >> _C)


@kernel
def _fill(key: np.uint64, words: npt.NDArray[np.uint64]) -> None:
    for i in range(words.size):
        words[i] = _word(key, i)


@kernel
def _add(
    pixels: Bytes,
    noisy: Bytes,
    bits: npt.NDArray[np.uint16],
    table: npt.NDArray[np.int16],
    bounds: Floats,
    key: np.uint64,
) -> None:
    for i in range(pixels.size):
        added = table[bits[i]]
        if added == _DIVIDED:
            more = np.float64(_word(key, i) >> _D) * 2.0**-53
            side = np.searchsorted(bounds, (bits[i] + more) / _CELLS, side="right")
            added = np.int16(side - _MOST)
        total = np.int16(np.int16(pixels[i]) + added)
        noisy[i] = np.uint8(min(max(total, np.int16(0)), np.int16(_MOST)))
