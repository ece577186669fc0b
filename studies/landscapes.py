"""A synthetic landscape with random worlds in which each evaluation draws a shape."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sada_gym.parameters import all_can_exist

WAVES = 40
THRESHOLD = 0.3

Array = npt.NDArray[np.float64]


class Landscape:
    """Smooth random waves over mu, other ones a shape; five of the dimensions matter most.

    Q = sigmoid of them, and the agent is fooled where Q <= 0.3.

    Args:
        seed: Draws the waves.
        dimension: d.
        rate: The share of uniform mu that fools.
        shapes: Number of shapes; each evaluation draws one.
        noise: How much the shapes' waves weigh beside the ones that they share.
    """

    def __init__(
        self,
        seed: int,
        *,
        dimension: int = 8,
        rate: float = 0.35,
        shapes: int = 8,
        noise: float = 0.4,
    ) -> None:
        self.dimension = dimension
        rng = np.random.default_rng(seed)
        relevance = np.full(dimension, 0.15)
        relevance[rng.permutation(dimension)[:5]] = 1.0
        self._directions = 1.6 * rng.normal(size=(shapes + 1, WAVES, dimension)) * relevance
        self._phases = rng.uniform(0.0, 2.0 * np.pi, (shapes + 1, WAVES))
        self._weights = rng.normal(size=(shapes + 1, WAVES)) * np.sqrt(2.0 / WAVES)
        self._weights[1:] *= noise
        uniform = rng.uniform(-1.0, 1.0, (4000, dimension))
        self._level = float(np.quantile(self._height(uniform), rate))
        self._rng = np.random.default_rng(seed + 1)

    def __call__(self, mu: npt.ArrayLike) -> Array:
        """Score mu (n, d), each with a random shape, and give (n,)."""
        height = self._height(np.asarray(mu, dtype=np.float64))
        drawn = self._rng.integers(height.shape[1], size=len(height))
        odds = np.exp(2.5 * (height[np.arange(len(height)), drawn] - self._level))
        score: Array = odds / (odds + (1.0 - THRESHOLD) / THRESHOLD)
        return score

    def fooling_rate(self, mu: npt.ArrayLike) -> Array:
        """Return the share of the shapes that fool the agent at each mu, (n,)."""
        rate: Array = (self._height(np.asarray(mu, dtype=np.float64)) <= self._level).mean(axis=1)
        return rate

    def _height(self, mu: Array) -> Array:
        """Sum the waves, and give (n, shapes)."""
        angle = mu @ self._directions.reshape(-1, self.dimension).T
        waves = np.cos(angle.reshape(len(mu), *self._phases.shape) + self._phases)
        sums: Array = (waves * self._weights).sum(axis=2)
        return sums[:, :1] + sums[:, 1:]


class FunctionOracle:
    """The simplest oracle: a function with a budget."""

    permits = staticmethod(all_can_exist)

    def __init__(self, function: object, budget: int, threshold: float = THRESHOLD) -> None:
        self.function, self.remaining, self.threshold = function, budget, threshold
        self.queries: list[npt.NDArray[np.float32]] = []

    def __call__(self, mu: npt.ArrayLike) -> Array:
        """Score mu (n, d), and give (n,)."""
        batch = np.asarray(mu, dtype=np.float32)
        assert len(batch) <= self.remaining
        self.remaining -= len(batch)
        self.queries.append(batch)
        return np.asarray(self.function(batch), dtype=np.float64)  # type: ignore[operator]
