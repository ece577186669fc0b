"""One palette for all frames of a video, chosen so that small coloured things keep their colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.arrays import Bytes, Floats
from sada_gym.frames import Frame

_BITS = 6
"""Colours are looked up, and counted, on a grid of so many bits a channel."""
_MAX_COLOURS = 6_000
_RARE = 0.4
"""A colour that fills a hundred times the area gets 100 ** 0.4 times the weight."""

# Oklab (Ottosson, 2020): lightness and two hues, in which distances are as people see them
_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


class Palette:
    """At most `count` colours, (count, 3) uint8, that stand for all those of some frames."""

    def __init__(self, frames: Sequence[Frame], count: int) -> None:
        from scipy.spatial import cKDTree

        self.colours = _cluster(*_histogram(frames), count)
        levels = (np.arange(1 << _BITS) + 0.5) * (256 / (1 << _BITS))
        grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
        _, nearest = cKDTree(_oklab(self.colours.astype(np.float64))).query(_oklab(grid))
        self._nearest: Bytes = nearest.astype(np.uint8)

    def indices(self, frame: Frame) -> Bytes:
        """Return the index of the nearest colour for each pixel, (height, width)."""
        return np.asarray(self._nearest[_cells(frame)])


def _cells(pixels: Bytes) -> npt.NDArray[np.int32]:
    red, green, blue = (pixels[..., k].astype(np.int32) >> (8 - _BITS) for k in range(3))
    return np.asarray((red << 2 * _BITS) | (green << _BITS) | blue)


def _histogram(frames: Sequence[Frame]) -> tuple[Floats, Floats]:
    """Return the mean colours of the cells of a coarse grid, (n, 3), and their weights, (n,)."""
    cells = 1 << 3 * _BITS
    counts, sums = np.zeros(cells), np.zeros((cells, 3))
    step = max(1, len(frames) // 40)
    for frame in [*frames[::step], frames[-1]]:
        pixels = frame.reshape(-1, 3)
        cell = _cells(pixels)
        counts += np.bincount(cell, minlength=cells)
        for k in range(3):
            sums[:, k] += np.bincount(cell, pixels[:, k], minlength=cells)
    filled = np.flatnonzero(counts)
    filled = filled[np.argsort(-counts[filled], kind="stable")][:_MAX_COLOURS]
    return sums[filled] / counts[filled, None], counts[filled] ** _RARE


def _cluster(colours: Floats, weights: Floats, count: int) -> Bytes:
    if len(colours) <= count:
        return np.round(colours).astype(np.uint8)
    from sklearn.cluster import KMeans

    means = KMeans(count, n_init=1, max_iter=30, random_state=0)
    means.fit(_oklab(colours), sample_weight=weights)
    # the mean of the colours themselves, not in Oklab, which need not be turned back
    total = np.bincount(means.labels_, weights, minlength=count)
    sums = [np.bincount(means.labels_, weights * colours[:, k], minlength=count) for k in range(3)]
    used = total > 0
    return np.round(np.stack(sums, axis=1)[used] / total[used, None]).astype(np.uint8)


def _oklab(colours: Floats) -> Floats:
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.cbrt(linear @ _TO_CONES.T) @ _TO_LAB.T)
