"""An exact Gaussian process whose posterior over a pool of candidates is kept up to date."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from sada_gym.adversaries.models.arrays import AnyFloats, Floats, Indices
from sada_gym.adversaries.models.exact_gp import Kernel

MIN_NOISE = 1e-3
"""Least noise variance of a fit as a share of the signal's: float32 factors stay exact enough."""

_BLOCK, _PADDING = 256, 32
_LENGTHS, _SIGNALS, _NOISES = (0.02, 200.0), (0.05, 20.0), (MIN_NOISE, 10.0)
_FIT_STEPS = 60


class Matern(Kernel):
    """The Matern kernel with nu = 5/2; the hyper-parameters are those of `Kernel`.

    Rasmussen & Williams 2006, equation 4.17, as Snoek, Larochelle & Adams 2012 use it.
    """

    def __call__(self, a: AnyFloats, b: AnyFloats) -> Floats:
        """Return the covariances of the function at a (n, d) and b (m, d): (n, m)."""
        r = _scaled_distances(a / self.length_scales, b / self.length_scales)
        covariance: Floats = 1.0 + r
        covariance += r * r / 3.0
        covariance *= self.signal
        covariance *= np.exp(np.negative(r, out=r), out=r)
        return covariance


def fit_matern(x: AnyFloats, y: Floats, start: Matern | None = None) -> Matern:
    """Fit the kernel to values y (n,) at x (n, d) in [-1, 1]^d, y standardised.

    Maximises the marginal likelihood (Rasmussen & Williams 2006, equations 5.8 and 5.9) times the
    prior of the length-scales of Hvarfner, Hellsten & Nardi 2024 ("Vanilla Bayesian optimization
    performs great in high dimensions"), without which few points in many dimensions settle nothing.
    Without a kernel to start from the search starts at the prior's mode.
    """
    d = x.shape[1]
    mode = 2.0**0.5 - 3.0 + np.log(2.0 * d**0.5)  # the prior is for sides of 1, ours are 2
    theta = np.append(np.full(d, mode), np.log([1.0, 0.1]))
    if start is not None:
        theta = np.log([*start.length_scales, start.signal, start.noise / start.signal])
    bounds = np.log([_LENGTHS] * d + [_SIGNALS, _NOISES])
    optimum = minimize(
        _loss,
        np.clip(theta, *bounds.T),
        args=(x.astype(np.float64), y, mode),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _FIT_STEPS},
    )
    *length_scales, signal, ratio = np.exp(optimum.x)
    return Matern(np.array(length_scales), float(signal), float(signal * ratio))


class PoolPosterior:
    """The posterior at every candidate of a pool, exact after each observation.

    With K the covariance of n observations, noise included, and L its Cholesky factor, it holds L
    and V = L^-1 k(observations, pool). So an observation costs one product with V, O(n * pool),
    where an evaluation from scratch costs O(n^3 + n^2 * pool).

    It starts from values y, (n,), at x, (n, d), and will hold `capacity` observations, n among
    them, in capacity * (m + capacity) numbers for m candidates. L and V of float32 take half the
    time and memory of float64. Mean and variance, (m,) float64, are the posterior ones of the
    function (not of an observation) at each candidate.
    """

    def __init__(
        self,
        kernel: Matern,
        pool: AnyFloats,
        x: AnyFloats,
        y: Floats,
        *,
        capacity: int,
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self.pool = pool.copy()
        self._kernel = kernel
        self._x = np.empty((capacity, pool.shape[1]))
        self._y, self._z = np.empty(capacity), np.zeros(capacity)
        self._l: AnyFloats = np.zeros((capacity, capacity), dtype)
        # columns a power of two apart would share their places in the processor's caches
        self._v: AnyFloats = np.empty((capacity, len(pool) + _PADDING), dtype)[:, : len(pool)]
        self._rows = self._valued = 0
        for i in range(0, len(x), _BLOCK):
            self._append(x[i : i + _BLOCK], y[i : i + _BLOCK])
        self.mean, self.variance = self._solve(self.pool, self._v[: self._rows])

    def condition(self, index: int) -> None:
        """Count a candidate as observed: variances shrink now, means change with its value."""
        n = self._rows
        row = self._v[:n, index].copy()
        scale = np.sqrt(max(self.variance[index], 0.0) + self._kernel.noise)
        point = self.pool[index : index + 1]
        added = (self._kernel(point, self.pool)[0] - row @ self._v[:n]) / scale
        self._l[n, :n], self._l[n, n] = row, scale
        self._v[n], self._x[n] = added, point
        self.variance -= added**2
        self._rows += 1

    def observe(self, values: Floats) -> None:
        """Take in the values of all that was conditioned on since the last call, in its order."""
        start, stop = self._valued, self._rows
        self._y[start:stop] = values
        for i in range(start, stop):
            rest = self._y[i] - self._l[i, :i] @ self._z[:i]
            self._z[i] = rest / self._l[i, i]
        self.mean += self._z[start:stop] @ self._v[start:stop]
        self._valued = stop

    def replace(self, slots: Indices, points: AnyFloats) -> None:
        """Put new candidates (r, d) into the slots (r,) of the pool."""
        columns = np.empty((self._rows, len(slots)), self._v.dtype)
        self.mean[slots], self.variance[slots] = self._solve(points, columns)
        self._v[: self._rows, slots] = columns
        self.pool[slots] = points

    def mean_at_observations(self) -> Floats:
        """Return the posterior mean at every observation that has a value: (n,)."""
        n = self._valued
        weights = solve_triangular(self._l[:n, :n], self._z[:n], lower=True, trans=1)
        smooth: Floats = self._y[:n] - self._kernel.noise * weights
        return smooth

    def _append(self, points: AnyFloats, values: Floats) -> None:
        n, stop = self._rows, self._rows + len(points)
        columns = np.empty((n, len(points)), self._l.dtype)
        mean, _ = self._solve(points, columns)
        rest = self._kernel(points, points) + self._kernel.noise * np.eye(len(points))
        factor = cholesky(rest - columns.T @ columns, lower=True)
        self._l[n:stop, :n], self._l[n:stop, n:stop] = columns.T, factor
        self._x[n:stop], self._y[n:stop] = points, values
        self._z[n:stop] = solve_triangular(factor, values - mean, lower=True)
        self._rows = self._valued = stop

    def _solve(self, points: AnyFloats, columns: AnyFloats) -> tuple[Floats, Floats]:
        """Write L^-1 k(observations, points) to columns (n, r); give mean and variance, (r,)."""
        mean, variance = np.zeros(len(points)), np.full(len(points), self._kernel.signal)
        for i in range(0, self._rows, _BLOCK):
            j = min(i + _BLOCK, self._rows)
            rest = self._kernel(self._x[i:j], points) - self._l[i:j, :i] @ columns[:i]
            solved = solve_triangular(self._l[i:j, i:j], rest, lower=True, check_finite=False)
            columns[i:j] = solved
            mean += self._z[i:j] @ solved
            variance -= (solved**2).sum(axis=0)
        return mean, variance


def _scaled_distances(a: AnyFloats, b: AnyFloats) -> Floats:
    """Return sqrt(5) |a - b|, pairwise: (n, m)."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    squares: Floats = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1)
    squares -= 2.0 * (a @ b.T)
    np.maximum(squares, 0.0, out=squares)
    squares *= 5.0
    return np.sqrt(squares, out=squares)


def _loss(theta: Floats, x: Floats, y: Floats, mode: float) -> tuple[float, Floats]:
    """Return the negative log posterior of the log hyper-parameters, and its gradient.

    theta holds the logs of the length-scales, the signal, and the noise's ratio to it.
    """
    *scales, signal, ratio = np.exp(theta)
    scaled = x / np.array(scales)
    r = _scaled_distances(scaled, scaled)
    decay = np.exp(-r)
    covariance = signal * ((1.0 + r + r * r / 3.0) * decay + ratio * np.eye(len(x)))
    factor = cholesky(covariance, lower=True, check_finite=False)
    inverse = solve_triangular(factor, np.eye(len(x)), lower=True, check_finite=False)
    inverse = inverse.T @ inverse
    weights = inverse @ y
    offset = (theta[:-2] - mode) / 3.0**0.5
    loss = 0.5 * (y @ weights) + np.log(np.diagonal(factor)).sum() + 0.5 * offset @ offset

    slope = inverse - np.outer(weights, weights)
    # d K / d log scale_k = signal 5/3 (1 + r) exp(-r) (x_k - x'_k)^2 / scale_k^2
    pull = slope * (signal * 5.0 / 3.0 * (1.0 + r) * decay)
    gradient = np.empty_like(theta)
    gradient[:-2] = pull.sum(axis=1) @ scaled**2 - (scaled * (pull @ scaled)).sum(axis=0)
    gradient[:-2] += offset / 3.0**0.5
    gradient[-2] = 0.5 * (len(y) - y @ weights)
    gradient[-1] = 0.5 * signal * ratio * np.trace(slope)
    return float(loss), gradient
