"""Gaussian process regression on a subset of regressors, for many points, with held-out means."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from sada_gym.adversaries.models.exact_gp import Array, Kernel, fit_kernel

_JITTER = 1e-6
_BLOCK = 4_000
_MAX_LEVERAGE = 0.999


class SparseGP:
    """The posterior mean of a Gaussian process that lives on some of its points.

    The subset of regressors (Rasmussen & Williams 2006, section 8.3.1): n points in m^2 n
    operations. It is a ridge regression, so its leave-one-out means cost nothing more.

    Args:
        x: (n, d) points.
        y: (n,) values.
        rng: Picks the regressors, and the points that the kernel's hyper-parameters are fitted to.
        regressors: The most regressors, m.
        subset: The most points that the hyper-parameters are fitted to.

    Attributes:
        held_out: (n,) the mean at each point, learnt from all other points.
    """

    def __init__(
        self,
        x: Array,
        y: Array,
        rng: np.random.Generator,
        *,
        regressors: int = 1_200,
        subset: int = 400,
    ) -> None:
        self._mean, self._scale = float(y.mean()), float(y.std()) or 1.0
        z = (y - self._mean) / self._scale
        order = rng.permutation(len(x))
        self._kernel = Kernel(np.ones(x.shape[1]), 1.0, 1.0)
        some, of_some = x[order[:subset]], z[order[:subset]]
        if spread := float(of_some.std()):
            self._kernel = fit_kernel(some, (of_some - of_some.mean()) / spread)
        self._points = x[order[:regressors]]

        covariance = self._kernel(self._points, self._points)
        covariance[np.diag_indices_from(covariance)] += _JITTER * self._kernel.signal
        root = np.linalg.cholesky(covariance)
        features = solve_triangular(root, self._kernel(self._points, x), lower=True)
        normal = features @ features.T
        normal[np.diag_indices_from(normal)] += self._kernel.noise
        factor = cho_factor(normal, lower=True)
        coefficients = cho_solve(factor, features @ z)
        self._weights = solve_triangular(root, coefficients, lower=True, trans="T")

        half = solve_triangular(factor[0], features, lower=True)
        leverage = np.minimum((half**2).sum(axis=0), _MAX_LEVERAGE)
        left_out = z - (z - features.T @ coefficients) / (1.0 - leverage)
        self.held_out: Array = self._mean + self._scale * left_out

    def __call__(self, x: Array) -> Array:
        """Return the mean at x (m, d): (m,)."""
        blocks = [x[start : start + _BLOCK] for start in range(0, len(x), _BLOCK)]
        means = [self._kernel(block, self._points) @ self._weights for block in blocks]
        return self._mean + self._scale * np.concatenate(means)
