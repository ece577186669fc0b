"""Analytic landscapes where luck counts: fooling sets whose worlds fool often, others seldom."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from studies.landscapes import THRESHOLD, WAVES

_UNIFORM = 4_000
_SPOTS = 200

Array = npt.NDArray[np.float64]


class LuckyLandscape:
    """A world fools with chance `inside` in the fooling set, `outside` elsewhere; no score helps.

    The fooling set has a shape. `smooth`: random waves are low. `spots`: some of 200 random cells,
    each a centre's nearest points (a Voronoi diagram), so that a spot is 1 in 200 of the box.

    Args:
        seed: Draws the set.
        shape: `smooth` or `spots`.
        dimension: d.
        inside: The chance to fool in the set, (0, 1).
        outside: The chance to fool elsewhere, (0, 1).
        volume: The set's share of the box.
    """

    def __init__(
        self,
        seed: int,
        *,
        shape: str,
        dimension: int,
        inside: float = 0.8,
        outside: float = 0.05,
        volume: float = 0.15,
    ) -> None:
        self.dimension, self._shape = dimension, shape
        self._inside, self._outside = inside, outside
        rng = np.random.default_rng([seed, 52])
        if shape == "spots":
            self._cells = cKDTree(rng.uniform(-1.0, 1.0, (_SPOTS, dimension)))
            self._fools = rng.permutation(_SPOTS) < volume * _SPOTS
        else:
            self._directions = 2.5 * rng.normal(size=(dimension, WAVES)) / np.sqrt(dimension)
            self._phases = rng.uniform(0.0, 2.0 * np.pi, WAVES)
            uniform = rng.uniform(-1.0, 1.0, (_UNIFORM, dimension))
            self._level = float(np.quantile(self._height(uniform), volume))
        self._rng = np.random.default_rng([seed, 53])

    def __call__(self, mu: npt.ArrayLike) -> Array:
        """Score mu (n, d): (n,), below 0.3 where luck has it that the world fools."""
        rate = self.fooling_rate(mu)
        fooled = self._rng.random(len(rate)) < rate
        drawn = self._rng.random(len(rate))
        score: Array = np.where(fooled, THRESHOLD * drawn, 1.0 - (1.0 - THRESHOLD) * drawn)
        return score

    def fooling_rate(self, mu: npt.ArrayLike) -> Array:
        """Return the chance that each mu (n, d) fools: (n,)."""
        points = np.asarray(mu, dtype=np.float64)
        if self._shape == "spots":
            inside = self._fools[self._cells.query(points)[1]]
        else:
            inside = self._height(points) <= self._level
        rate: Array = np.where(inside, self._inside, self._outside)
        return rate

    def _height(self, mu: Array) -> Array:
        height: Array = np.cos(mu @ self._directions + self._phases).sum(axis=1)
        return height
