"""`cross-entropy`: adaptive importance sampling of the fooling set with Gaussian mixtures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import expit, logsumexp

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import NONE_FOOLED, Arrays, FittedAdversary, validate_array
from sada_gym.adversaries.models.mixture import Mixture, fit_best_mixture
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import FALLBACK_SIZE, evaluate, evaluate_uniform
from sada_gym.errors import AdversaryError
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats

_CALIBRATION_DRAWS, _ACCEPTANCE = 4096, 0.9
_TRIES = 50


@dataclass(frozen=True)
class CrossEntropyOptions(Options):
    """The options of `cross-entropy`.

    Attributes:
        uniform_share: The share of the budget that the first, uniform stage spends.
        stages: The number of later stages.
        elite: The quantile of the scores that sets the level.
        components: The most components of a mixture; powers of two up to it are tried.
        defensive: The share of uniform points in the later stages.
    """

    uniform_share: float = option(0.3, 0, 1, inside=True)
    stages: int = option(6, 1, 1_000)
    elite: float = option(0.2, 0, 1, inside=True)
    components: int = option(16, 1, 1_024)
    defensive: float = option(0.05, 0, 1, inside=True)


_Stage = tuple[int, Mixture | None, float]
"""How many points were drawn, from which mixture (None is uniform), its mass in the box."""


class CrossEntropy(FittedAdversary):
    """Fits mixtures in stages to the points that fool; each draws the next stage's points.

    This is the cross-entropy method (Rubinstein & Kroese 2004) for the target density
    1{Q <= epsilon}, with mixtures as proposals (Kurtz & Song 2013; Geyer, Papaioannou & Straub
    2019). The weight of a point is the uniform density divided by the density of all proposals
    together (balance heuristic, Veach & Guibas 1995). If Q is random, the mixture's target is
    proportional to the probability p(mu) to fool. Samples are thinned by an estimate of p
    (discriminant analysis by mixtures, Hastie & Tibshirani 1996). See `CrossEntropyOptions`.
    """

    name: ClassVar[str] = "cross-entropy"
    packages = ("scikit-learn",)
    options_class = CrossEntropyOptions
    options: CrossEntropyOptions

    def query(self, oracle: Query) -> Evaluations:
        first, *later = self._split(oracle.remaining)
        newest = queries = evaluate_uniform(first, self.dimension, oracle, self.rng)
        self._stages: list[_Stage] = [(first, None, 1.0)]
        level = math.inf
        for count in later:
            quantile = float(np.quantile(newest.score, self.options.elite, method="lower"))
            level = max(min(level, quantile), self.threshold)
            mixture = self._fit_mixture(queries, level)
            self._stages.append((count, mixture, mixture.mass_in_box(self.rng)))
            points = mixture.sample(count, self.rng)
            uniform = self.rng.random(count) < self.options.defensive
            points[uniform] = self.rng.uniform(-1.0, 1.0, (int(uniform.sum()), self.dimension))
            newest = evaluate(points.astype(np.float32), oracle)
            queries += newest
        return queries

    def fit(self, queries: Evaluations) -> None:
        level = self.threshold
        if queries.score.min() > level:
            self.flags.append(NONE_FOOLED)
            level = float(np.sort(queries.score)[:FALLBACK_SIZE][-1])
        self._mixture = self._fit_mixture(queries, level)
        # mixtures of the points at or below the level and above it, which thin the samples
        fooled = queries.score <= level
        self._classes: list[Mixture] = []
        self._log_odds = self._ceiling = 0.0
        if fooled.all():
            return
        self._classes = [
            fit_best_mixture(queries.mu[chosen], self._sizes, self.rng)
            for chosen in (fooled, ~fooled)
        ]
        self._log_odds = math.log(fooled.sum() / (~fooled).sum())
        odds = self._odds(self._mixture.sample(_CALIBRATION_DRAWS, self.rng))
        self._ceiling = float(np.quantile(odds, _ACCEPTANCE))

    def _split(self, budget: int) -> list[int]:
        uniform = math.ceil(budget * self.options.uniform_share)
        ends = np.linspace(uniform, budget, self.options.stages + 1).astype(int)
        return [uniform, *(int(count) for count in np.diff(ends) if count)]

    def _fit_mixture(self, queries: Evaluations, level: float) -> Mixture:
        elite = queries.mu[queries.score <= level].astype(np.float64)
        densities = [self._log_density(elite, *stage) for stage in self._stages]
        log_density = logsumexp(densities, axis=0)
        weights = np.exp(log_density.min() - log_density)
        return fit_best_mixture(elite, self._sizes, self.rng, weights=weights)

    def _log_density(
        self, points: Floats, count: int, mixture: Mixture | None, mass: float
    ) -> Floats:
        if mixture is None:
            return np.full(len(points), math.log(count))
        truncated = mixture.log_density(points) - math.log(mass)
        truncated += points.shape[1] * math.log(2.0)
        uniform = self.options.defensive
        mixed: Floats = np.logaddexp(math.log(uniform), math.log1p(-uniform) + truncated)
        return math.log(count) + mixed

    @property
    def _sizes(self) -> list[int]:
        return [2**i for i in range(self.options.components.bit_length())]

    def _odds(self, points: Floats) -> Floats:
        below, above = (mixture.log_density(points) for mixture in self._classes)
        probability: Floats = expit(self._log_odds + below - above)
        return probability

    def draw(self, n: int) -> Floats:
        # a tenth of the mixture's draws are kept for sure, unless a file says otherwise
        for _ in range(_TRIES):
            points = self._mixture.sample(2 * n + 64, self.rng)
            if self._classes:
                chance = self.rng.random(len(points)) * self._ceiling
                points = points[chance <= self._odds(points)]
            if len(points):
                return points
        raise AdversaryError(
            "Expected some of the mixture's draws to be kept, but all were thinned out: what the "
            "adversary learnt is broken. Train it again."
        )

    def arrays(self) -> Arrays:
        arrays: dict[str, Any] = {"odds": np.array([self._log_odds, self._ceiling])}
        for i, mixture in enumerate([self._mixture, *self._classes]):
            arrays |= {f"{i}.{name}": array for name, array in mixture.to_arrays().items()}
        return arrays

    def restore(self, arrays: Arrays) -> None:
        self._log_odds, self._ceiling = map(float, validate_array(arrays, "odds", 2))
        self._mixture, *self._classes = (
            Mixture.from_arrays(
                {n: arrays[f"{i}.{n}"] for n in ("weights", "means", "factors")}, self.dimension
            )
            for i in range(3 if "2.weights" in arrays else 1)
        )
