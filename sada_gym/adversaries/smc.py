"""`smc`: subset simulation, a sequential Monte Carlo sampler of the fooling set."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from sklearn.neighbors import NearestNeighbors
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats

_SMALLEST_STEP, _LARGEST_STEP = 0.01, 2.0
_MIN_SPREAD = 1e-3


@dataclass(frozen=True)
class SMCOptions(Options):
    """The options of `smc`.

    Attributes:
        uniform_share: The share of the budget that the uniform pool spends.
        level_share: The share of the budget that the chains spend at each level above epsilon.
        level_probability: The share of a population that the next level keeps.
        steps: The number of steps of a chain at a level.
        acceptance: The target rate of accepted steps.
        neighbours: The number of nearest neighbours to sample towards.
    """

    uniform_share: float = option(0.3, 0, 1, inside=True)
    level_share: float = option(0.1, 0, 1, inside=True)
    level_probability: float = option(0.2, 0, 1, inside=True)
    steps: int = option(5, 1, 10_000)
    acceptance: float = option(0.3, 0, 1, inside=True)
    neighbours: int = option(20, 1, 1_000)


class SMC(FittedAdversary):
    """A population of points that moves down levels of Q, and then within the fooling set.

    This is subset simulation (Au & Beck 2001), a sequential Monte Carlo sampler (Del Moral, Doucet
    & Jasra 2006). A chain keeps the score of its mu, as in pseudo-marginal Metropolis (Andrieu &
    Roberts 2009), so chains follow the density proportional to the probability to fool. A sample
    lies at a random place between a point that fooled and one of its nearest neighbours that fooled
    (SMOTE, Chawla et al. 2002). Each point that fooled counts once, however long a chain stayed
    there. See `SMCOptions`.
    """

    name: ClassVar[str] = "smc"
    packages = ("scikit-learn",)
    options_class = SMCOptions
    options: SMCOptions

    def query(self, oracle: Query) -> Evaluations:
        o, budget = self.options, oracle.remaining
        uniform = math.ceil(budget * o.uniform_share)
        per_level = math.ceil(budget * o.level_share)
        queries = population = evaluate_uniform(uniform, self.dimension, oracle, self.rng)
        self._scale = 0.5
        level = math.inf
        while level > oracle.threshold and oracle.remaining:
            quantile = float(np.quantile(population.score, o.level_probability, method="lower"))
            level = max(quantile, oracle.threshold)
            population = population[population.score <= level]
            n = oracle.remaining if level == oracle.threshold else min(per_level, oracle.remaining)
            states, asked = self._walk(population, level, n, oracle)
            population += states
            queries += asked
        return queries

    def fit(self, queries: Evaluations) -> None:
        self._points = np.unique(self._select_fooling(queries).chosen, axis=0).astype(np.float64)
        self._nearest = np.zeros((1, 1), np.intp)
        if len(self._points) > 1:
            count = min(self.options.neighbours, len(self._points) - 1)
            # more threads would give other last bits, and so other neighbours
            with threadpool_limits(1):
                search = NearestNeighbors(n_neighbors=count).fit(self._points)
                self._nearest = search.kneighbors(return_distance=False)

    def _walk(
        self, population: Evaluations, level: float, n: int, oracle: Query
    ) -> tuple[Evaluations, Evaluations]:
        chains = math.ceil(n / self.options.steps)
        start = self.rng.choice(len(population), chains, replace=chains > len(population))
        mu, score = population.mu[start], population.score[start]
        spread = np.maximum(population.mu.std(axis=0), _MIN_SPREAD)
        states = proposals = population[:0]
        for taken in range(0, n, chains):
            mu, score = mu[: n - taken], score[: n - taken]
            step = self._scale * spread * self.rng.normal(size=mu.shape)
            asked = evaluate(reflect(mu + step).astype(np.float32), oracle)
            accepted = asked.score <= level
            mu = np.where(accepted[:, None], asked.mu, mu)
            score = np.where(accepted, asked.score, score)
            states += Evaluations.unseeded(mu, score)
            proposals += asked
            growth = math.exp(accepted.mean() - self.options.acceptance)
            self._scale = min(max(self._scale * growth, _SMALLEST_STEP), _LARGEST_STEP)
        return states, proposals

    def draw(self, n: int) -> Floats:
        first = self.rng.integers(len(self._points), size=n)
        second = self._nearest[first, self.rng.integers(self._nearest.shape[1], size=n)]
        way = self.rng.random((n, 1))
        drawn: Floats = self._points[first] + way * (self._points[second] - self._points[first])
        return drawn
