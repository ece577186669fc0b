"""Where to draw worlds: in proportion to their density and the predicted chance of a failure."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp, ndtr
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.determinism import single_threaded

SCALES = (1.0, 1.5, 2.0, 3.0)
"""Draws of ordinary use, stretched by these factors, look for failures further out."""

_COMPONENTS, _RESAMPLED, _ROUNDS, _SEARCHED = 4, 1_500, 3, 3_000
_SPREAD, _SHRINK = 0.3, 0.3


class Use(Protocol):
    """The density of ordinary use, over points z."""

    dimension: int

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw points, (count, d)."""

    def log_density(self, z: Floats) -> Floats:
        """Return the logarithm of the density at points, (n, d): (n,), maybe -inf."""


class Model(Protocol):
    """Predicts failures."""

    def depth(self, z: Floats) -> Floats:
        """Return how deep a failure is expected, in standard deviations, (n,), maybe -inf."""


def stretched(use: Use, count: int, rng: np.random.Generator) -> Floats:
    """Draw points of ordinary use, stretched by `SCALES` in turn, (count, d)."""
    drawn: Floats = use.sample(count, rng) * np.resize(SCALES, count)[:, None]
    return drawn


@dataclass(frozen=True, eq=False)
class Candidates:
    """Points that were drawn near failures.

    Attributes:
        z: The points, (n, d).
        ratio: The density of ordinary use over that of the points, (n,).
        depth: How deep the model expects them to fail, (n,).
    """

    z: Floats
    ratio: Floats
    depth: Floats


@dataclass(frozen=True, eq=False)
class Proposal:
    """Densities in proportion to that of ordinary use and the chance of a failure.

    Attributes:
        use: Ordinary use.
        model: Predicts the chance.
        widths: The chance is taken as so many times as uncertain as it is; each has its share of
            `shares`.
        norms: The mean chance of each under ordinary use, by candidates.
        mixture: Gaussians that were fitted to where failures are predicted.
    """

    use: Use
    model: Model
    widths: tuple[float, ...]
    shares: tuple[float, ...]
    norms: Floats
    mixture: GaussianMixture | None = None

    @classmethod
    def fitted(
        cls,
        use: Use,
        model: Model,
        widths: Sequence[float],
        shares: Sequence[float],
        rng: np.random.Generator,
    ) -> Proposal:
        """Fit Gaussians to where failures are predicted, by the cross-entropy method."""
        proposal = cls(use, model, tuple(widths), tuple(shares), np.ones(len(widths)))
        for _ in range(_ROUNDS):
            found = proposal.candidates(_SEARCHED, rng)
            norms = np.array([(found.ratio * ndtr(found.depth / w)).mean() for w in widths])
            proposal = replace(proposal, norms=np.maximum(norms, 1e-300))
            weights = found.ratio * proposal.boost(found.depth)
            if not weights.sum() > 0.0:
                return proposal
            chosen = found.z[rng.choice(len(weights), _RESAMPLED, p=weights / weights.sum())]
            proposal = replace(proposal, mixture=_gaussians(chosen, rng))
        return proposal

    def boost(self, depth: Floats) -> Floats:
        """Return the ratio of the density to that of ordinary use, by depths, (n,)."""
        each = zip(self.widths, self.shares, self.norms, strict=True)
        return np.asarray(sum(s / norm * ndtr(depth / width) for width, s, norm in each))

    def candidates(self, count: int, rng: np.random.Generator) -> Candidates:
        """Draw points near failures, whose own density is known."""
        near = 0 if self.mixture is None else int((1.0 - _SPREAD) * count)
        parts = [stretched(self.use, count - near, rng)]
        if self.mixture is not None:
            for i, number in enumerate(rng.multinomial(near, self.mixture.weights_)):
                noise = rng.normal(size=(self.use.dimension, number))
                # the precision is R R^T
                root = self.mixture.precisions_cholesky_[i]
                step = solve_triangular(root, noise, trans="T", lower=False).T
                parts.append(self.mixture.means_[i] + step)
        z = np.concatenate(parts)
        each = [
            self.use.log_density(z / scale) - self.use.dimension * np.log(scale) for scale in SCALES
        ]
        logs = logsumexp(each, axis=0) + np.log((count - near) / count / len(SCALES))
        if self.mixture is not None:
            with single_threaded():
                logs = np.logaddexp(logs, self.mixture.score_samples(z) + np.log(near / count))
        ratio = np.exp(each[0] - logs)
        depth = np.full(count, -np.inf)
        depth[ratio > 0.0] = self.model.depth(z[ratio > 0.0])
        return Candidates(z, ratio, depth)


def _gaussians(z: Floats, rng: np.random.Generator) -> GaussianMixture:
    mixture = GaussianMixture(
        _COMPONENTS,
        reg_covar=0.02,
        max_iter=15,
        tol=1e-2,
        init_params="k-means++",
        random_state=int(rng.integers(2**31)),
    )
    with single_threaded(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        mixture.fit(z)
    # wider than what it was fitted to, so that no weight is large: points of ordinary use have
    # a covariance of about 1
    eye = np.eye(z.shape[1])
    wider = (1.0 - _SHRINK) * mixture.covariances_ + _SHRINK * eye
    # R with R R^T = precision and R upper triangular
    mixture.precisions_cholesky_ = np.linalg.inv(np.linalg.cholesky(wider)).transpose(0, 2, 1)
    return mixture
