"""`level-set`: learn where the agent fails from all queries; sample there evenly (our own)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import NONE_FOOLED, Arrays, FittedAdversary, validate_array
from sada_gym.adversaries.models.hits import MIN_NEAR, Hits, between, in_turn
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.models.surrogate import MODELS, Surrogate
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import draw_permitted, evaluate, evaluate_uniform
from sada_gym.errors import BudgetTooSmall
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats, Bools, Floats, Indices
from sada_gym.measures.coverage import density_and_coverage
from sada_gym.parameters import Mu

MIN_BUDGET = 20
"""Fewer queries fit no surrogate: its trees are judged by folds of them."""

_POOL_PER_QUERY, _MIN_POOL, _MAX_POOL, _MAX_POOLS = 10, 2_000, 20_000, 10
"""Random mu among which queries are chosen; and at most so many pools to find the level set in."""
_MIN_SET = 1_000
"""Points that tell the level set's shape and its coverage."""
_RARE, _WALK_STEPS = 0.002, 60
"""A set with a smaller share of the box is sampled by a walk of so many steps."""
_LEVELS = (0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
"""Levels above 1/2 that are tried in this order."""
_SAMPLES, _DRAWS = 250, 10
"""Coverage is predicted for so many samples, and averaged over so many draws of them."""
_MAX_TRIAL, _PREDICTION, _SURE, _BEHIND = 200, 50, 0.9, 0.1
"""The trial of hits; see `_try_hits`."""
_CHECKS, _MIN_KEPT = 0.4, 20
"""Where hits pay: the share of a round that checks them; with fewer that stood it none is used."""


@dataclass(frozen=True)
class LevelSetOptions(Options):
    """The options of `level-set`.

    Attributes:
        uniform: The share of the budget that the first, uniform part spends.
        rounds: The number of rounds that spend the rest.
        explore: The share of each round that is uniform.
        coverage: A higher level must keep this share of the coverage; 1.0 never raises the level.
        volume: The smallest volume of the level set, as a share of the volume predicted to fool.
        trial: The share of the budget that tries mu near hits; an equal share tries the level set.
            With 0, samples are never drawn near hits.
        width: The standard deviation of a step from a hit, in each parameter.
        keep: Samples are drawn near a hit only if its probability to fool again is at least this.
        beside: The share of samples that are drawn near hits, if the trial was in favour of hits.
        models: The models that the surrogate combines: `trees`, and `process` (a Gaussian process).
    """

    uniform: float = option(0.4, 0.05, 1)
    rounds: int = option(4, 0, 100)
    explore: float = option(0.25, 0, 1)
    coverage: float = option(0.98, 0, 1)
    volume: float = option(1.0 / 3.0, 0, 1)
    trial: float = option(0.05, 0, 0.25)
    width: float = option(0.03, 0, 1, inside=True)
    keep: float = option(0.45, 0, 1)
    beside: float = option(0.75, 0, 1)
    models: tuple[str, ...] = option(tuple(MODELS), choices=tuple(MODELS), max_items=len(MODELS))


class LevelSet(FittedAdversary):
    """Learns the probability p of fooling from all queries; samples evenly where it is high.

    The first part of the budget is uniform. Each later round fits a `Surrogate` and queries random
    mu, which it chooses in proportion to p (1 - p): this is highest at the boundary of the fooling
    set (compare Bryan et al. 2005, "Active learning for identifying function threshold
    boundaries"). Samples are uniform over {p >= level}, by rejection from the box, or by a
    Metropolis walk within the set if it is small. The level is 1/2, raised as far as the predicted
    coverage (Naeem et al. 2020) allows. The set keeps at least the share `volume` of the volume
    that is predicted to fool.

    If scores are random, mu near a *hit* (a query that fooled) may fool more often than the level
    set does. Once 20 queries have fooled, a trial compares the two. If mu near hits fool about as
    often or more, later rounds also query near hits and between them. Most samples then lie near
    hits that are likely to fool again, if there are at least 20. See `LevelSetOptions`.

    Attributes:
        level: The lowest p in the level set.
        hits_pay: Whether mu near hits fooled about as often as the level set in the trial, or more.
    """

    name: ClassVar[str] = "level-set"
    packages = ("scikit-learn",)
    options_class = LevelSetOptions
    options: LevelSetOptions
    level: float = 0.5
    hits_pay: bool = False

    def uniform_part(self, queries: int) -> int:
        """Return how many queries the first, uniform part has."""
        first = max(int(self.options.uniform * queries), MIN_BUDGET)
        return first if self.options.rounds else queries

    def query(self, oracle: Query) -> Evaluations:
        budget = oracle.remaining
        if budget < MIN_BUDGET:
            raise BudgetTooSmall(
                f"Expected a budget of at least {MIN_BUDGET} queries, got {budget}. Raise it."
            )
        rounds, first = self.options.rounds, self.uniform_part(budget)
        trial, self.hits_pay = min(int(self.options.trial * budget), _MAX_TRIAL), False
        queries = evaluate_uniform(first, self.dimension, oracle, self.rng)
        for i in range(1, rounds + 1):
            part = first + (budget - first) * i // rounds - len(queries)
            if not part:
                continue
            surrogate = self._fit_surrogate(queries, self.rng)
            pool = self._uniform(max(_pool_size(budget), 4 * part))
            p = surrogate(pool)
            each = min(trial, part // 2)
            if each and not surrogate.raised:
                queries += self._try_hits(queries, surrogate, pool, p, each, oracle)
                part, trial = part - 2 * each, 0
            checks = self._check_hits(queries, surrogate, int(_CHECKS * part))
            chosen = self._choose(surrogate, pool, p, part - len(checks))
            queries += evaluate(np.concatenate([checks, chosen]), oracle)
        return queries

    def _try_hits(
        self,
        queries: Evaluations,
        surrogate: Surrogate,
        pool: Mu,
        p: Floats,
        each: int,
        oracle: Query,
    ) -> Evaluations:
        """Try which fools more often, mu close to hits or the level set: `each` queries of both.

        The surrogate may be too hopeful of its level set, so its prediction counts as no more than
        `_PREDICTION` queries. Checks will find the hits that were luck, so hits pay if they fool at
        most the share `_BEHIND` less often than the level set; but nothing is to be gained where
        that fools in `_SURE`.
        """
        hits = queries.mu[queries.fooled(self.threshold)].astype(np.float64)
        beside = self._step(hits[in_turn(each, len(hits), self.rng)])
        # stable: the order of equal chances would depend on the processor
        likely = np.argsort(-p, kind="stable")[: max(each, int(self.options.volume * p.sum()))]
        inside = pool[self.rng.choice(likely, each, replace=False)]
        tried = evaluate(np.concatenate([beside, inside]), oracle)
        fooled = tried.fooled(self.threshold)

        def rate(mu: Mu, fooled: Bools) -> float:
            predicted = _PREDICTION * float(surrogate(mu).mean())
            return (predicted + int(fooled.sum())) / (_PREDICTION + each)

        of_hits, of_set = rate(beside, fooled[:each]), rate(inside, fooled[each:])
        self.hits_pay = of_set < _SURE and of_hits >= (1.0 - _BEHIND) * of_set
        return tried

    def _check_hits(self, queries: Evaluations, surrogate: Surrogate, count: int) -> Mu:
        """Choose queries close to hits that may have been luck, and up to as many between hits."""
        if not self.hits_pay:
            return self._uniform(0)
        hits, half = self._hits(queries, surrogate), count // 2
        likely = hits.kept(0.5)
        beside = self._step(hits.most_in_doubt(count - half))
        if len(likely) <= MIN_NEAR:
            return beside
        # a way from hit to hit may leave the feasible region, and may do so everywhere
        middle = _mu(between(likely, half, self.rng))
        middle = middle[self._permits(middle)]
        return np.concatenate([beside, middle])

    def _hits(self, queries: Evaluations, surrogate: Surrogate) -> Hits:
        mu = queries.mu.astype(np.float64)
        learnt = len(surrogate.held_out)
        predicted = np.append(surrogate.held_out, surrogate(mu[learnt:]))
        radius = 2.0 * self.options.width * np.sqrt(self.dimension)
        return Hits(mu, queries.fooled(self.threshold), predicted, radius)

    def _step(self, centres: Floats) -> Mu:
        """Step once from each centre, (n, d), or from some twice where a step is not permitted."""

        def step(count: int) -> Mu:
            around = np.resize(centres, (count, self.dimension))
            return _mu(reflect(around + self.options.width * self.rng.normal(size=around.shape)))

        return draw_permitted(step, len(centres), self._permits)

    def _fit_surrogate(self, queries: Evaluations, rng: np.random.Generator) -> Surrogate:
        return Surrogate(queries.mu, queries.score, self.threshold, rng, self.options.models)

    def _choose(self, surrogate: Surrogate, pool: Mu, p: Floats, count: int) -> Mu:
        # too few fool to know the boundary: go where the scores are lowest
        odds = (p**4 if surrogate.raised else self._acquisition(surrogate, pool, p)) + 1e-12
        odds = (1.0 - self.options.explore) * odds / odds.sum() + self.options.explore / len(pool)
        return pool[self.rng.choice(len(pool), count, replace=False, p=odds)]

    def _acquisition(self, surrogate: Surrogate, pool: Mu, p: Floats) -> Floats:  # noqa: ARG002
        """Return the value of querying each mu of the pool, which fools with chance p: (m,)."""
        return p * (1.0 - p)

    def fit(self, queries: Evaluations) -> None:
        if not queries.fooled(self.threshold).any():
            self.flags.append(NONE_FOOLED)
        rng = np.random.default_rng(int(self.rng.integers(2**62)))
        self._surrogate = self._fit_surrogate(queries, rng)
        pool, p = self._predict_pool(_pool_size(len(queries)))
        rows = np.flatnonzero(p >= 0.5)
        if not len(rows):
            self.flags.append("no mu is predicted to fool more often than not: the likeliest taken")
        # at least the likeliest hundredth of a per cent, so that there is something to sample
        share = max(self.options.volume * float(p.mean()), 0.0001)
        highest = float(np.quantile(p, 1.0 - share))
        self.level = min(0.5, highest)
        if self.options.coverage < 1.0 and len(rows) >= 2 * _MIN_SET:
            self._raise_level(pool, p, rows, highest)
        inside = p >= self.level
        self._share = float(inside.mean())
        self._starts = pool[inside][:_MIN_SET]
        self._centres = np.zeros((0, self.dimension))
        if self.hits_pay:
            kept = self._hits(queries, self._surrogate).kept(self.options.keep)
            # checks that leave a handful of hits refute them: samples would crowd beside luck
            if len(kept) >= _MIN_KEPT:
                self._centres = kept

    def _raise_level(self, pool: Mu, p: Floats, rows: Indices, highest: float) -> None:
        real, others = pool[rows[:_MIN_SET]], rows[_MIN_SET:]
        minimum = self.options.coverage * self._predict_coverage(pool, p, others, real)
        for level in (level for level in _LEVELS if level <= highest):
            higher = others[p[others] >= level]
            if len(higher) < _MIN_SET or self._predict_coverage(pool, p, higher, real) < minimum:
                return
            self.level = level

    def _predict_pool(self, size: int) -> tuple[Mu, Floats]:
        pool, p, most = self._uniform(0), np.zeros(0), _MAX_POOLS * size
        while len(pool) < most:
            drawn = self._uniform(size)
            pool, p = np.concatenate([pool, drawn]), np.append(p, self._surrogate(drawn))
            inside = (p >= 0.5).sum()
            if inside >= 4 * _MIN_SET:
                break
            if len(pool) == most and 0 < inside < 2 * _MIN_SET:
                most = _MAX_POOLS * _MAX_POOL  # so few points would leave its level where it is
        return pool, p

    def _predict_coverage(self, pool: Mu, p: Floats, rows: Indices, real: Mu) -> float:
        covered = []
        for _ in range(_DRAWS):
            samples = self.rng.choice(rows, _SAMPLES, replace=False)
            fooling = pool[samples[self.rng.random(_SAMPLES) < p[samples]]]
            reference = real[self.rng.choice(len(real), _SAMPLES, replace=False)]
            covered.append(density_and_coverage(reference, fooling).coverage)
        return float(np.mean(covered))

    def arrays(self) -> Arrays:
        return {"hits_pay": np.array([self.hits_pay], np.uint8)}

    def restore(self, arrays: Arrays) -> None:
        self.hits_pay = bool(validate_array(arrays, "hits_pay", 1)[0])
        super().restore(arrays)

    def draw(self, n: int) -> AnyFloats:
        if not len(self._centres):
            return self._draw_level_set(n)
        count = int(self.rng.binomial(n, self.options.beside))
        beside = self._step(self._centres[in_turn(count, len(self._centres), self.rng)])
        level_set = self._draw_level_set(n - count)[: n - count]
        return self.rng.permutation(np.concatenate([beside, level_set]))

    def _draw_level_set(self, n: int) -> AnyFloats:
        if self._share < _RARE:
            return self._walk(n)
        pool = self._uniform(min(int(1.2 * n / self._share) + 100, _MAX_POOLS * _MAX_POOL))
        return pool[self._surrogate(pool) >= self.level]

    def _walk(self, n: int) -> AnyFloats:
        """Walk within {p >= level} from the points known to lie in it (Metropolis; Ter Braak 2006).

        Steps are differences of two random points of the set, so that they have its shape.
        """
        mu = self._starts[self.rng.integers(len(self._starts), size=n)].astype(np.float64)
        for _ in range(_WALK_STEPS):
            pair = self._starts[self.rng.integers(len(self._starts), size=(2, n))]
            size = self.rng.choice([0.1, 0.3, 1.0], size=(n, 1))
            step = size * (pair[0] - pair[1]) + 0.01 * self.rng.normal(size=mu.shape)
            proposed = reflect(mu + step)  # which keeps the proposal symmetric
            accepted = self._surrogate(proposed) >= self.level
            mu[accepted] = proposed[accepted]
        return mu


def _pool_size(queries: int) -> int:
    return min(max(_POOL_PER_QUERY * queries, _MIN_POOL), _MAX_POOL)


def _mu(values: Floats) -> Mu:
    mu: Mu = values.astype(np.float32)
    return mu
