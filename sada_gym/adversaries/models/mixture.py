"""Gaussian mixtures on the box [-1, 1]^d: weighted EM that copes with few points, and samples."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits
from typing_extensions import Self

from sada_gym.adversaries.models.arrays import Floats
from sada_gym.errors import UserError

_VARIANCE_FLOOR = 1e-6
_MIN_SHARE = 1e-9
_STEPS, _TOLERANCE = 100, 1e-3
_TRIES = 100
_TRIAL_POINTS, _FOLDS = 2000, 5


@dataclass(frozen=True)
class Mixture:
    """A mixture of Gaussians with full covariances, which samples within [-1, 1]^d.

    Weights are (k,) and sum to 1, means (k, d), factors (k, d, d): lower Cholesky factors of the
    covariances.

    Raises:
        ValueError: If the shapes do not match, or the weights are not probabilities.
    """

    weights: Floats
    means: Floats
    factors: Floats

    def __post_init__(self) -> None:
        """Check shapes and weights, which may come from a file."""
        k, d = self.means.shape if self.means.ndim == 2 else (0, 0)
        if not k or self.weights.shape != (k,) or self.factors.shape != (k, d, d):
            raise UserError(
                "Expected weights (k,), means (k, d) and factors (k, d, d), k >= 1, got "
                f"{self.weights.shape}, {self.means.shape} and {self.factors.shape}."
            )
        # a NaN is neither at least 0 nor close to 1
        if not (self.weights >= 0.0).all() or not abs(self.weights.sum() - 1.0) <= 1e-8:
            raise UserError(f"Expected weights of at least 0 that sum to 1, got {self.weights}.")

    def sample(self, n: int, rng: np.random.Generator) -> Floats:
        """Draw n points of the mixture truncated to the box: (n, d) float64 in [-1, 1].

        A draw outside the box is repeated, with a new component. (SADA's authors clip it, so their
        samples pile up on the faces.) A point that is still outside after 100 tries is reflected.
        """
        points = np.empty((n, self.means.shape[1]))
        outside = np.arange(n)
        with threadpool_limits(1):
            for _ in range(_TRIES):
                points[outside] = self._draw_anywhere(len(outside), rng)
                outside = outside[(np.abs(points[outside]) > 1.0).any(axis=1)]
                if not len(outside):
                    break
        points[outside] = reflect(points[outside])
        return points

    def log_density(self, points: npt.ArrayLike) -> Floats:
        """Return the log density of the mixture, not truncated, at points (n, d): (n,).

        To compare mixtures, take its mean over held-out points. The log density of the truncated
        mixture is higher by -log of the mixture's mass inside the box.
        """
        with threadpool_limits(1):
            return _log_sum(self._log_joint(np.asarray(points, np.float64)))

    def mass_in_box(self, rng: np.random.Generator, *, draws: int = 4096) -> float:
        """Estimate the mixture's mass inside the box from `draws` draws; it is never 0."""
        with threadpool_limits(1):
            inside = (np.abs(self._draw_anywhere(draws, rng)) <= 1.0).all(axis=1).sum()
        return max(float(inside), 0.5) / draws

    def to_arrays(self) -> dict[str, Floats]:
        """Return the fields by name, for a file."""
        return {"weights": self.weights, "means": self.means, "factors": self.factors}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]], dimension: int) -> Self:
        """Make a mixture from what `to_arrays` returned; other entries are ignored.

        Raises:
            ValueError: If the shapes do not match each other or the dimension.
        """
        mixture = cls(arrays["weights"], arrays["means"], arrays["factors"])
        if mixture.means.shape[1] != dimension:
            raise UserError(
                f"Expected a mixture in {dimension} dimensions, got one in "
                f"{mixture.means.shape[1]}."
            )
        return mixture

    def _draw_anywhere(self, n: int, rng: np.random.Generator) -> Floats:
        component = rng.choice(len(self.weights), size=n, p=self.weights)
        points = rng.normal(size=(n, self.means.shape[1]))
        for k in np.unique(component):
            own = component == k
            points[own] = self.means[k] + points[own] @ self.factors[k].T
        return points

    def _log_joint(self, points: Floats) -> Floats:
        joint = np.empty((len(points), len(self.weights)))
        constant = -0.5 * points.shape[1] * np.log(2.0 * np.pi) + np.log(self.weights)
        for k, factor in enumerate(self.factors):
            scaled = (points - self.means[k]) @ np.linalg.inv(factor).T
            log_volume = np.log(np.diagonal(factor)).sum()
            joint[:, k] = constant[k] - log_volume - 0.5 * (scaled**2).sum(axis=1)
        return joint


def fit_mixture(
    points: npt.ArrayLike,
    components: int,
    rng: np.random.Generator,
    *,
    weights: npt.ArrayLike | None = None,
) -> Mixture:
    """Fit a mixture with full covariances by weighted EM, started from k-means.

    EM seeks a posterior mode, after Fraley & Raftery 2007 ("Bayesian regularization for normal
    mixture estimation and model-based clustering"): each component's covariance is averaged with
    d + 2 pseudo-points of a common covariance, so even a component of a single point has one. The
    common covariance is that within the clusters of k-means, plus components / n times Fraley &
    Raftery's choice (the covariance of all points, divided by components^(2/d)). Both are shrunk
    towards a sphere by the OAS rule (Chen, Wiesel, Eldar & Hero 2010). With one component and many
    points, the result is the maximum likelihood.

    One point, or identical ones, (n, d), are enough; the mixture has at most as many components as
    there are distinct points. Only the ratios of the weights, (n,), at least 0, matter; the sample
    size is Kish's effective one.

    Raises:
        ValueError: If there are no points, or shapes or values are bad.
    """
    x, w = _validate(points, weights)
    with threadpool_limits(1):
        return _fit(x, w, components, rng)


def fit_best_mixture(
    points: npt.ArrayLike,
    sizes: Sequence[int],
    rng: np.random.Generator,
    *,
    weights: npt.ArrayLike | None = None,
) -> Mixture:
    """Fit mixtures of several sizes; return the one of the best cross-validated log likelihood.

    If several sizes are equally good, it takes the first. It also takes the first if there are
    fewer than two points for each fold. Points and weights are those of `fit_mixture`.

    Raises:
        ValueError: If there are no points or sizes, or shapes or values are bad.
    """
    if not sizes:
        raise UserError("Expected at least one size to try, got none.")
    x, w = _validate(points, weights)
    trial = rng.permutation(len(x))[:_TRIAL_POINTS]
    best = sizes[0]
    with threadpool_limits(1):
        if len(sizes) > 1 and len(trial) >= 2 * _FOLDS:
            likelihood = np.zeros(len(sizes))
            for i in range(_FOLDS):
                held_out, rest = trial[i::_FOLDS], np.delete(trial, np.s_[i::_FOLDS])
                for j, size in enumerate(sizes):
                    mixture = _fit(x[rest], w[rest], size, rng)
                    likelihood[j] += w[held_out] @ _log_sum(mixture._log_joint(x[held_out]))
            best = sizes[int(np.argmax(likelihood))]
        return _fit(x, w, best, rng)


def reflect(points: Floats) -> Floats:
    """Reflect points (n, d) at the faces of the box until they lie inside."""
    folded: Floats = 1.0 - np.abs((points + 1.0) % 4.0 - 2.0)
    return folded


def _fit(x: Floats, w: Floats, components: int, rng: np.random.Generator) -> Mixture:
    if components < 1:
        raise UserError(f"Expected at least 1 component, got {components}.")
    k = min(components, len(np.unique(x, axis=0)))
    with warnings.catch_warnings():
        # two distinct points may be equal to the rounding of k-means
        warnings.simplefilter("ignore", ConvergenceWarning)
        start = KMeans(k, n_init=1, random_state=int(rng.integers(2**31)))
        shares = np.eye(k)[start.fit_predict(x, sample_weight=w)]
    within = _covariance(x - shares @ start.cluster_centers_, w)
    whole = _covariance(x - np.average(x, axis=0, weights=w), w)
    prior = within + min(1.0, k / w.sum()) * whole / k ** (2.0 / x.shape[1])
    return _expectation_maximisation(x, w, shares, prior)


def _validate(points: npt.ArrayLike, weights: npt.ArrayLike | None) -> tuple[Floats, Floats]:
    x = np.asarray(points, np.float64)
    if x.ndim != 2 or 0 in x.shape or not np.isfinite(x).all():
        raise UserError(f"Expected finite points of shape (n, d), n >= 1, got shape {x.shape}.")
    w = np.ones(len(x)) if weights is None else np.asarray(weights, np.float64)
    if w.shape != (len(x),) or not np.isfinite(w).all() or w.min() < 0.0 or w.max() <= 0.0:
        raise UserError(
            f"Expected {len(x)} finite weights of at least 0 and one above 0, got shape {w.shape}."
        )
    x, w = x[w > 0.0], w[w > 0.0] / w.max()
    return x, w * (w.sum() / (w**2).sum())


def _covariance(offset: Floats, w: Floats) -> Floats:
    """Shrink the weighted covariance of centred points towards a sphere by OAS."""
    d = offset.shape[1]
    covariance: Floats = (offset * (w / w.sum())[:, None]).T @ offset
    variance = float(np.trace(covariance)) / d
    square = float((covariance**2).mean())
    excess = (w.sum() + 1.0) * (square - variance**2 / d)
    shrinkage = min(1.0, (square + variance**2) / excess) if excess > 0.0 else 1.0
    shrunk: Floats = (1.0 - shrinkage) * covariance + shrinkage * variance * np.eye(d)
    return shrunk


def _expectation_maximisation(x: Floats, w: Floats, shares: Floats, prior: Floats) -> Mixture:
    before = -np.inf
    for _ in range(_STEPS):
        mixture = _maximise(x, w[:, None] * shares, prior)
        joint = mixture._log_joint(x)
        evidence = _log_sum(joint)
        likelihood = float(w @ evidence) / w.sum()
        if abs(likelihood - before) < _TOLERANCE:
            break
        before, shares = likelihood, np.exp(joint - evidence[:, None])
    return mixture


def _maximise(x: Floats, shares: Floats, prior: Floats) -> Mixture:
    d = x.shape[1]
    counts = shares.sum(axis=0)
    alive = counts > _MIN_SHARE * counts.sum()
    counts, shares = counts[alive], shares[:, alive]
    means = (shares.T @ x) / counts[:, None]
    covariances = np.empty((len(counts), d, d))
    for k, count in enumerate(counts):
        offset = x - means[k]
        scatter = (offset * shares[:, k, None]).T @ offset
        covariances[k] = (scatter + (d + 2) * prior) / (count + d + 2)
    covariances += _VARIANCE_FLOOR * np.eye(d)
    factors = np.asarray(np.linalg.cholesky(covariances), np.float64)
    return Mixture(counts / counts.sum(), np.asarray(means, np.float64), factors)


def _log_sum(joint: Floats) -> Floats:
    evidence: Floats = logsumexp(joint, axis=1)
    return evidence
