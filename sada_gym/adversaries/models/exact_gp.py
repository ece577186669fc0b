"""Exact Gaussian process regression with an exponential kernel, in place and block by block.

scikit-learn's regressor computes the same, but holds three (n, n) matrices at once, which are 10 GB
at n = 20,000, and thirty where it differentiates the marginal likelihood in 8 dimensions. This
module holds one, and five.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, cho_factor, cho_solve, lapack, solve_triangular
from scipy.optimize import minimize
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial.distance import cdist

from sada_gym.adversaries.models.arrays import Floats

_BLOCK = 200  # larger arrays would be mapped, and their pages cleared, anew for each block
_MAX_FACTORISED = 4_000
_INDUCING, _JITTER = 1_000, 1e-8
_TOLERANCE, _MAX_STEPS = 1e-11, 300
_START = (2.0, 1.0, 0.1)
_LENGTH_SCALE_BOUNDS, _SIGNAL_BOUNDS, _NOISE_BOUNDS = (0.02, 200.0), (0.01, 100.0), (1e-4, 10.0)
_ITERATIONS = 50


@dataclass(frozen=True)
class Kernel:
    """k(a, b) = signal * exp(-r), r the distance of a / length_scales and b / length_scales.

    The Matern kernel with nu = 1/2 (Rasmussen & Williams 2006, equation 4.18), with (d,) scales,
    the variance of the process and, beside, that of the noise of an observation.
    """

    length_scales: Floats
    signal: float
    noise: float

    def __call__(self, a: Floats, b: Floats) -> Floats:
        """Return the covariances of a (n, d) and b (m, d) without noise: (n, m)."""
        covariance: Floats = cdist(a / self.length_scales, b / self.length_scales)
        np.negative(covariance, out=covariance)
        np.exp(covariance, out=covariance)
        covariance *= self.signal
        return covariance


def log_marginal_likelihood(kernel: Kernel, x: Floats, y: Floats) -> tuple[float, Floats]:
    """Return log p(y | x) and its gradient (Rasmussen & Williams 2006, equations 2.30 and 5.9).

    x is (n, d), y (n,), of zero mean. The derivatives, (d + 2,), are those by the logarithms of
    length-scales, signal and noise.
    """
    z = x / kernel.length_scales
    distance = cdist(z, z)
    signal = np.negative(distance)
    np.exp(signal, out=signal)
    signal *= kernel.signal
    factor = _factorise(kernel, signal.copy())
    weights = _solve(factor, y)
    value = -0.5 * y @ weights - np.log(factor.diagonal()).sum() - 0.5 * len(y) * np.log(2 * np.pi)

    inverse, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    slope = np.outer(weights, weights)
    for start in range(0, len(y), _BLOCK):  # dpotri writes the lower triangle alone
        stop = start + _BLOCK
        slope[start:stop, :start] -= inverse[start:stop, :start]
        slope[:start, start:stop] -= inverse[start:stop, :start].T
        corner = np.tril(inverse[start:stop, start:stop])
        slope[start:stop, start:stop] -= corner + np.tril(corner, -1).T
    slope *= 0.5
    by_noise = kernel.noise * np.trace(slope)
    slope *= signal
    by_signal = slope.sum()
    # sum over j, k of slope_jk (z_ji - z_ki)^2 / distance_jk, for each i without an (n, n, d) array
    np.divide(slope, distance, out=slope, where=distance > 0)
    by_length = 2.0 * (slope.sum(axis=1) @ z**2 - (z * (slope @ z)).sum(axis=0))
    return float(value), np.array([*by_length, by_signal, by_noise])


def fit_kernel(x: Floats, y: Floats) -> Kernel:
    """Find the hyper-parameters that maximise the marginal likelihood, by L-BFGS from one start.

    x is (n, d) in [-1, 1], y (n,), of zero mean and unit variance. Each step costs n^3 operations.
    """
    d = x.shape[1]

    def objective(logs: Floats) -> tuple[float, Floats]:
        value, gradient = log_marginal_likelihood(_kernel(logs), x, y)
        return -value, -gradient

    bounds = [*[_LENGTH_SCALE_BOUNDS] * d, _SIGNAL_BOUNDS, _NOISE_BOUNDS]
    optimum = minimize(
        objective,
        np.log([*[_START[0]] * d, *_START[1:]]),
        jac=True,
        method="L-BFGS-B",
        bounds=np.log(bounds),
        options={"maxiter": _ITERATIONS},
    )
    return _kernel(optimum.x)


def fit_weights(kernel: Kernel, x: Floats, y: Floats) -> Floats:
    """Solve (K + noise I) w = y for all n points: (n,).

    The posterior mean at a is k(a, x) w (Rasmussen & Williams 2006, 2.27). The solver holds one
    (n, n) float64 matrix, 3.2 GB at n = 20,000. Up to 4,000 points it factorises the matrix in
    place. Beyond, it takes conjugate gradients down to a residual of 1e-11 of y, and factorises
    only where 300 steps do not reach that.
    """
    n = len(x)
    upper = np.empty((n, n))
    for start in range(0, n, _BLOCK):
        upper[start : start + _BLOCK, start:] = kernel(x[start : start + _BLOCK], x[start:])
    # the transpose is LAPACK's own order, so that nothing is copied
    covariance = upper.T
    if n > _MAX_FACTORISED:
        np.fill_diagonal(covariance, kernel.signal + kernel.noise)
        product = LinearOperator(
            (n, n), lambda v: blas.dsymv(1.0, covariance, v, lower=1), dtype=y.dtype
        )
        rough = _rough_inverse(kernel, x)
        weights, left = cg(product, y, rtol=_TOLERANCE, maxiter=_MAX_STEPS, M=rough)
        if not left:
            return np.asarray(weights)
    return _solve(_factorise(kernel, covariance), y)


def predict_mean(kernel: Kernel, x: Floats, weights: Floats, at: Floats) -> Floats:
    """Return the posterior mean at (m, d): (m,)."""
    blocks = [at[start : start + _BLOCK] for start in range(0, len(at), _BLOCK)]
    return np.concatenate([kernel(block, x) @ weights for block in blocks])


def _rough_inverse(kernel: Kernel, x: Floats) -> LinearOperator:
    """Return the inverse of an approximation of K + noise I, which makes conjugate gradients short.

    The approximation is exact on the diagonal and of rank 1,000 elsewhere: FITC (Snelson &
    Ghahramani 2006, "Sparse Gaussian processes using pseudo-inputs"), inverted by Woodbury's
    identity.
    """
    points = x[:_INDUCING]
    root = kernel(points, points)
    root[np.diag_indices_from(root)] += _JITTER * kernel.signal
    features = solve_triangular(np.linalg.cholesky(root), kernel(points, x), lower=True)
    rest = kernel.noise + np.maximum(kernel.signal - (features**2).sum(axis=0), 0.0)
    inner = np.eye(len(points)) + (features / rest) @ features.T
    factor = cho_factor(inner, lower=True)

    def solve(v: Floats) -> Floats:
        solved: Floats = (v - features.T @ cho_solve(factor, features @ (v / rest))) / rest
        return solved

    return LinearOperator((len(x), len(x)), solve, dtype=x.dtype)


def _kernel(logs: Floats) -> Kernel:
    *length_scales, signal, noise = np.exp(logs)
    return Kernel(np.array(length_scales), float(signal), float(noise))


def _factorise(kernel: Kernel, covariance: Floats) -> Floats:
    np.fill_diagonal(covariance, kernel.signal + kernel.noise)
    factor, info = lapack.dpotrf(covariance, lower=1, clean=0, overwrite_a=1)
    # the least noise is far above the rounding errors
    assert info == 0, f"dpotrf gave {info}"
    return np.asarray(factor)


def _solve(factor: Floats, y: Floats) -> Floats:
    weights, _ = lapack.dpotrs(factor, y, lower=1)
    return np.asarray(weights)
