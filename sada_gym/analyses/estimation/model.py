"""Predicts from scores how likely a world fails: a quadratic trend and a Gaussian process."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, ndtri

from sada_gym.adversaries.models.exact_gp import Kernel, fit_kernel
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.determinism import single_threaded

_REGRESSORS, _SUBSET = 250, 200
_KNOTS = 25
_TREND, _JITTER, _MAX_LEVERAGE = 3.0, 1e-6, 0.99
_SHIFTS = np.linspace(-1.0, 1.0, 9)
_WIDTHS = np.geomspace(0.3, 4.0, 11)
_BLOCK = 4_000


class Scale:
    """Scores on a scale that does not depend on how they are scaled: normal scores of some draws.

    Between the quantiles of these draws, and beyond their ends, it is linear.
    """

    def __init__(self, score: Floats) -> None:
        ranks = (np.arange(len(score)) + 0.5) / len(score)
        at = np.linspace(ranks[0], ranks[-1], min(_KNOTS, len(score)))
        knots, first = np.unique(np.interp(at, ranks, np.sort(score)), return_index=True)
        heights = ndtri(at)
        # ties get the middle of their heights
        last = np.append(first[1:], len(at)) - 1
        self._knots, self._heights = knots, (heights[first] + heights[last]) / 2.0
        if len(knots) < 2:
            self._knots = np.array([knots[0] - 1.0, knots[0]])
            self._heights = np.array([-1.0, 0.0])

    def __call__(self, score: Floats) -> Floats:
        """Return the height of each score, (n,)."""
        knots, heights = self._knots, self._heights
        inside = np.interp(score, knots, heights)
        span = min(3, len(knots) - 1)
        low = (heights[span] - heights[0]) / (knots[span] - knots[0])
        high = (heights[-1] - heights[-1 - span]) / (knots[-1] - knots[-1 - span])
        below, above = np.minimum(score - knots[0], 0.0), np.maximum(score - knots[-1], 0.0)
        return np.asarray(inside + low * below + high * above)


class FailureModel:
    """The chance that a world fails, by points z, (n, d), their heights and the threshold's height.

    A sparse Gaussian process (FITC, Snelson and Ghahramani 2006) on a quadratic trend predicts the
    height. What it predicts for each point without it, by leave-one-out, calibrates the chance
    (Platt 1999).
    """

    def __init__(
        self, z: Floats, height: Floats, failed: Bools, level: float, rng: np.random.Generator
    ) -> None:
        near = np.argsort(np.abs(height - level), kind="stable")
        some = np.append(
            near[: _SUBSET // 2], rng.permutation(near[_SUBSET // 2 :])[: _SUBSET // 2]
        )
        order = np.append(near[: _REGRESSORS // 2], rng.permutation(near[_REGRESSORS // 2 :]))
        self._level = level
        with single_threaded():
            trend = _trend(z)
            normal = trend.T @ trend + np.eye(trend.shape[1])
            rest = height - trend @ np.linalg.solve(normal, trend.T @ height)
            spread = max(float(rest[some].std()), 1e-3)
            kernel = fit_kernel(z[some], (rest[some] - rest[some].mean()) / spread)
            self._kernel = Kernel(
                kernel.length_scales, kernel.signal * spread**2, kernel.noise * spread**2
            )
            self._points = z[order[:_REGRESSORS]]
            covariance = self._kernel(self._points, self._points)
            covariance[np.diag_indices_from(covariance)] += _JITTER * self._kernel.signal
            self._unroot = np.linalg.inv(np.linalg.cholesky(covariance)).T
            features, noise = self._features(z)
            scaled = features / noise[:, None]
            precision = scaled.T @ features
            precision[np.diag_indices_from(precision)] += 1.0
            self._unfactor = np.linalg.inv(np.linalg.cholesky(precision)).T
            self._weights = self._unfactor @ (self._unfactor.T @ (scaled.T @ height))
            spans = ((features @ self._unfactor) ** 2).sum(axis=1)
            leverage = np.minimum(spans / noise, _MAX_LEVERAGE)
            left_out = height - (height - features @ self._weights) / (1.0 - leverage)
            depth = (level - left_out) / np.sqrt(noise / (1.0 - leverage))
        self._shift, self._width = _calibrated(depth, failed)

    def _features(self, z: Floats) -> tuple[Floats, Floats]:
        near = self._kernel(z, self._points) @ self._unroot
        left = np.maximum(self._kernel.signal - (near**2).sum(axis=1), 0.0)
        return np.hstack([near, _trend(z)]), self._kernel.noise + left

    def depth(self, z: Floats) -> Floats:
        """Return how many standard deviations below the threshold scores are predicted, (n,)."""
        parts = [np.zeros(0)]
        with single_threaded():
            for start in range(0, len(z), _BLOCK):
                features, noise = self._features(z[start : start + _BLOCK])
                sd = np.sqrt(noise + ((features @ self._unfactor) ** 2).sum(axis=1))
                parts.append((self._level - features @ self._weights) / sd)
        return (np.concatenate(parts) + self._shift) / self._width


def _trend(z: Floats) -> Floats:
    """Return 1, z and the products of two of z, which count less: (n, k)."""
    rows, columns = np.triu_indices(z.shape[1])
    clipped = np.clip(z, -6.0, 6.0)
    products = clipped[:, rows] * clipped[:, columns]
    return _TREND * np.hstack([np.ones((len(z), 1)), clipped, 0.2 * products])


def _calibrated(depth: Floats, failed: Bools) -> tuple[float, float]:
    """Choose the shift and the width under which chances say best what failed."""
    few = min(int(failed.sum()), int((~failed).sum()))
    sign = np.where(failed, 1.0, -1.0)
    shifts = _SHIFTS if few >= 10 else np.zeros(1)
    best = (-np.inf, 0.0, 1.0)
    for shift in shifts:
        for width in _WIDTHS:
            fit = float(log_ndtr(sign * (depth + shift) / width).clip(-15.0).sum())
            # as prior knowledge: no shift, and a width of 1
            fit -= 2.0 * shift**2 + 2.0 * np.log(width) ** 2
            best = max(best, (fit, float(shift), float(width)))
    return best[1], best[2]
