"""The surrogate of `level-set`: the calibrated probability that a mu fools the agent."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import rankdata
from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor
from sklearn.linear_model import LogisticRegression
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.models.arrays import AnyFloats, Floats
from sada_gym.adversaries.models.exact_gp import Kernel, fit_kernel

_FOLDS = 4
_MIN_FOOLING, _FEWEST_FOOLING = 20, 5
_FEW, _FOREST = 100, 200
"""With at most so many points, a forest of so many trees takes the place of boosting."""
_JITTER, _BLOCK, _MAX_LEVERAGE = 1e-6, 4_000, 0.999


class CrossFittedTrees:
    """Gradient-boosted trees, one ensemble for each fold; the prediction is their mean.

    `held_out`, (n,), is each point's prediction by the ensemble that did not see it.
    """

    def __init__(self, x: Floats, y: Floats, rng: np.random.Generator) -> None:
        fold = rng.permutation(len(x)) % _FOLDS
        self.held_out: Floats = np.zeros(len(x))
        self.ensembles = []
        for left_out in range(_FOLDS):
            ensemble = HistGradientBoostingRegressor(
                max_iter=150,
                learning_rate=0.06,
                max_leaf_nodes=31,
                min_samples_leaf=10,
                l2_regularization=1.0,
                max_features=0.6,
                early_stopping=False,
                random_state=int(rng.integers(2**31)),
            ).fit(x[fold != left_out], y[fold != left_out])
            self.held_out[fold == left_out] = ensemble.predict(x[fold == left_out])
            self.ensembles.append(ensemble)

    def __call__(self, x: Floats) -> Floats:
        """Predict the values at x (m, d): (m,)."""
        mean: Floats = np.mean([ensemble.predict(x) for ensemble in self.ensembles], axis=0)
        return mean


class RandomisedTrees:
    """Extremely randomised trees (Geurts et al. 2006), which split few points, too.

    `held_out`, (n,), is each point's prediction by the trees whose draw left it out.
    """

    def __init__(self, x: Floats, y: Floats, rng: np.random.Generator) -> None:
        self._forest = ExtraTreesRegressor(
            _FOREST, bootstrap=True, oob_score=True, random_state=int(rng.integers(2**31))
        ).fit(x, y)
        self.held_out: Floats = self._forest.oob_prediction_

    def __call__(self, x: Floats) -> Floats:
        """Predict the values at x (m, d): (m,)."""
        values: Floats = self._forest.predict(x)
        return values


class SparseGP:
    """The posterior mean of a sparse Gaussian process, with m of the n points as regressors.

    This is the subset of regressors (Rasmussen & Williams 2006, section 8.3.1), which costs m^2 n
    operations. It is a ridge regression, so the leave-one-out means `held_out`, (n,), are free.
    The kernel's hyper-parameters are fitted to a `subset` of the points.
    """

    def __init__(
        self,
        x: Floats,
        y: Floats,
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
        self.held_out: Floats = self._mean + self._scale * left_out

    def __call__(self, x: Floats) -> Floats:
        """Return the mean at x (m, d): (m,)."""
        blocks = [x[start : start + _BLOCK] for start in range(0, len(x), _BLOCK)]
        means = [self._kernel(block, self._points) @ self._weights for block in blocks]
        return self._mean + self._scale * np.concatenate(means)


Model = CrossFittedTrees | RandomisedTrees | SparseGP


def fit_trees(x: Floats, y: Floats, rng: np.random.Generator) -> Model:
    """Fit boosted trees, or a forest to so few points that boosting would hardly split them."""
    return (RandomisedTrees if len(x) <= _FEW else CrossFittedTrees)(x, y, rng)


MODELS: Mapping[str, Callable[[Floats, Floats, np.random.Generator], Model]] = {
    "trees": fit_trees,
    "process": SparseGP,
}
"""The models that predict the score, by name."""


class Surrogate:
    """P(Q <= threshold | mu), from trees and a Gaussian process that predict the score's rank.

    Ranks do not depend on the scale of the scores: with a threshold of 1e-4, a squared error would
    miss the differences that matter. Trees find sharp, axis-aligned regions in many dimensions; a
    Gaussian process finds smooth regions. A logistic regression combines both predictions
    (stacking, Wolpert 1992) and calibrates them (Platt 1999); it learns from predictions that were
    made without the point itself. If fewer than 20 queries fool, the threshold is raised to the
    20th lowest score, as in the cross-entropy method, and `raised` is true. With at most 100
    queries, the number is not 20 but a tenth of the queries, at least 5. `held_out`, (n,), is the
    probability that each training mu fools, predicted without that mu.
    """

    def __init__(
        self,
        mu: AnyFloats,
        score: Floats,
        threshold: float,
        rng: np.random.Generator,
        models: Sequence[str] = tuple(MODELS),
    ) -> None:
        x = mu.astype(np.float64)
        few = max(_FEWEST_FOOLING, len(score) // 10)
        count = min(few if len(score) <= _FEW else _MIN_FOOLING, len(score))
        level = max(threshold, float(np.partition(score, count - 1)[count - 1]))
        self.raised = level > threshold
        fooled = score <= level
        self._stack: LogisticRegression | None = None
        self.held_out: Floats = np.ones(len(score))
        if fooled.all():
            return
        y = rankdata(score) / len(score)
        # more threads would give other last bits
        with threadpool_limits(1):
            self.regressions = [MODELS[name](x, y, rng) for name in models]
            predicted = np.stack([r.held_out for r in self.regressions], axis=1)
            self._centre, self._scale = predicted.mean(axis=0), predicted.std(axis=0) + 1e-12
            standard = (predicted - self._centre) / self._scale
            self._stack = LogisticRegression(C=10.0).fit(standard, fooled)
            self.held_out = self._stack.predict_proba(standard)[:, 1]

    def __call__(self, mu: AnyFloats) -> Floats:
        """Return the probability of fooling at mu (m, d): (m,)."""
        if self._stack is None or not len(mu):
            return np.ones(len(mu))
        x = mu.astype(np.float64)
        with threadpool_limits(1):
            return self.calibrated([r(x) for r in self.regressions])

    def calibrated(self, predicted: Sequence[Floats]) -> Floats:
        """Turn the ranks that each model predicts, (m,), into the probability of fooling, (m,)."""
        assert self._stack is not None
        standard = (np.stack(predicted, axis=1) - self._centre) / self._scale
        probability: Floats = self._stack.predict_proba(standard)[:, 1]
        return probability
