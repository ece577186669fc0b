"""`level-set` that checks its hits: it asks next to them, and draws samples there where that pays.

A hit is a query that fooled. Where luck counts, a hit may have been luck, and a surrogate of a
thousand queries may not see the shape of the fooling set. Then a hit that was checked says more
about the world beside it than the surrogate does. Between two hits there often are more. The level
set's own samples cover what no hit has found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import cdist

from sada_gym.adversaries.level_set import LevelSet, LevelSetOptions
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.models.surrogate import Surrogate
from sada_gym.adversaries.options import option
from sada_gym.adversaries.query_pool import draw_permitted
from sada_gym.arrays import AnyFloats, Bools, Floats, Indices
from sada_gym.evaluations import Evaluations
from sada_gym.parameters import Mu

_MAX_CHECKS = 2
_TRIAL, _STEPS, _POOL = 30, 500, 10_000
_SLACK = 0.9
"""Before all checks are made, some of the hits that were luck are still among those kept."""
_NEIGHBOURS = 3
_BETWEEN = (0.3, 0.7)
"""Where a check between two hits goes, from one to the other."""


@dataclass(frozen=True)
class CheckedHitsOptions(LevelSetOptions):
    """The options of `level-set`, and those of its checks.

    Attributes:
        checks: The largest share of a round that checks hits; 0 never does.
        between: The share of the checks that go between two hits, and may be hits of their own.
        width: The standard deviation of a step from a hit, in each parameter.
        keep: The least chance to fool again of a hit that samples lie beside.
        sure: Where the level set's samples are predicted to fool more often, it alone is sampled.
        pays: How often mu beside hits have to fool by prediction, as a share of what is predicted
            at level 1/2: else checks rest, and the level set alone is sampled. Samples beside hits
            have to fool more often than not, too.
        beside: The least share of samples beside hits.
    """

    checks: float = option(0.5, 0, 1)
    between: float = option(0.5, 0, 1)
    width: float = option(0.03, 0, 1, inside=True)
    keep: float = option(0.45, 0, 1)
    sure: float = option(0.9, 0, 1)
    pays: float = option(1.0, 0, 2)
    beside: float = option(0.75, 0, 1)


class Hits:
    """The queries that fooled, and what the queries close to them say of the chance to do so again.

    A later hit within the radius of an earlier one is no hit of its own: it checks the earlier one.

    Args:
        mu: All queries in their order, (n, d).
        fooled: Which of them fooled, (n,).
        chance: The chance that each fools, predicted without it, (n,).
        radius: How close a query is that checks a hit.

    Attributes:
        mu: The hits, (h, d).
        chance: Their chances to fool again: the mean of the prediction and of the outcomes at the
            hit and within the radius, (h,).
        checks: How many queries check a hit; one that checks two counts twice.
    """

    def __init__(self, mu: Floats, fooled: Bools, chance: Floats, radius: float) -> None:
        rows = np.flatnonzero(fooled)
        close = cdist(mu[rows], mu[rows]) <= radius
        first: list[int] = []
        for i in range(len(rows)):
            if not close[i, first].any():
                first.append(i)
        self.mu = mu[rows[first]]
        close_to = cdist(self.mu, mu) <= radius
        self._queries = close_to.sum(axis=1)
        fooling = close_to @ fooled.astype(np.float64)
        self.checks = int(self._queries.sum()) - len(first)
        self.chance: Floats = (chance[rows[first]] + fooling) / (1 + self._queries)

    def to_check(self, count: int) -> Indices:
        """Choose the hits to check, at most twice as many as there are: (count,) rows.

        Each check goes where chance (1 - chance) is highest, for so many queries close by.
        """
        doubt, queries = self.chance * (1.0 - self.chance), self._queries.astype(np.float64)
        chosen = []
        for _ in range(min(count, _MAX_CHECKS * len(self.mu))):
            chosen.append(int(np.argmax(doubt / (1.0 + queries))))
            queries[chosen[-1]] += 1.0
        return np.array(chosen, np.intp)

    def kept(self, keep: float) -> Floats:
        """Return the hits of at least a chance: (m, d)."""
        return self.mu[self.chance >= keep]


class CheckedHits(LevelSet):
    """A part of each round asks close to hits, and most samples lie there.

    The part is the share of the level set's samples that are predicted not to fool; of the samples
    it is twice that share. A few checks say first whether more would pay. See `CheckedHitsOptions`.
    """

    name: ClassVar[str] = "checked-hits"
    options_class = CheckedHitsOptions
    options: CheckedHitsOptions

    def _next(self, queries: Evaluations, surrogate: Surrogate, pool: Mu, count: int) -> Mu:
        checks = self._checks(queries, surrogate, pool, count)
        chosen = super()._next(queries, surrogate, pool, count - len(checks))
        return np.concatenate([checks, chosen])

    def _checks(self, queries: Evaluations, surrogate: Surrogate, pool: Mu, count: int) -> Mu:
        hits = self._hits(queries, surrogate)
        if surrogate.raised or not len(hits.mu):
            return self._uniform(0)
        predicted = self._predict_half(surrogate, pool)
        checks = int(min(1.0 - predicted, self.options.checks) * count)
        if hits.checks < _TRIAL:
            return self._beside(hits.mu[hits.to_check(min(checks, _TRIAL))])
        if self._rate_beside(hits, surrogate) < _SLACK * self.options.pays * predicted:
            return self._uniform(0)
        likely = hits.kept(0.5)
        between = int(self.options.between * checks) if len(likely) > _NEIGHBOURS else 0
        beside = self._beside(hits.mu[hits.to_check(checks - between)])
        return np.concatenate([beside, self._between(likely, between)])

    def _between(self, hits: Floats, count: int) -> Mu:
        """Go from hits, each about as often as any other, to one of those nearest to them."""
        if not count:
            return self._uniform(0)
        distances = cdist(hits, hits)
        np.fill_diagonal(distances, np.inf)
        nearest = np.argsort(distances, axis=1)[:, :_NEIGHBOURS]

        def step(n: int) -> Mu:
            rows = np.resize(self.rng.permutation(len(hits)), n)
            others = nearest[rows, self.rng.integers(_NEIGHBOURS, size=n)]
            way = self.rng.uniform(*_BETWEEN, (n, 1))
            mu: Mu = (hits[rows] + way * (hits[others] - hits[rows])).astype(np.float32)
            return mu

        return draw_permitted(step, count, self._permits)

    def _hits(self, queries: Evaluations, surrogate: Surrogate) -> Hits:
        radius = 2.0 * self.options.width * np.sqrt(self.dimension)
        fooled = queries.fooled(self.threshold)
        return Hits(queries.mu.astype(np.float64), fooled, surrogate.held_out, radius)

    def _fit(self, queries: Evaluations) -> None:
        super()._fit(queries)
        self._centres, self._part = np.zeros((0, self.dimension)), 0.0
        if self._surrogate.raised or not self.options.checks:
            return
        sure = float(self._surrogate(self._starts).mean())
        hits = self._hits(queries, self._surrogate)
        predicted = self._predict_half(self._surrogate, self._uniform(_POOL))
        least = max(0.5, self.options.pays * predicted)
        if sure <= self.options.sure and self._rate_beside(hits, self._surrogate) >= least:
            self._centres = hits.kept(self.options.keep)
            self._part = min(1.0, max(self.options.beside, 2.0 * (1.0 - sure)))

    def _predict_half(self, surrogate: Surrogate, pool: Mu) -> float:
        """Predict how often the level set fools at level 1/2, which no rise made smaller."""
        p = surrogate(pool)
        level = min(0.5, float(np.quantile(p, 1.0 - self.options.volume * p.mean())))
        return float(p[p >= level].mean())

    def _rate_beside(self, hits: Hits, surrogate: Surrogate) -> float:
        """Predict how often mu beside the hits that are kept fool; 0 where none is kept."""
        kept = hits.kept(self.options.keep)
        if not len(kept):
            return 0.0
        return float(surrogate(self._beside(np.resize(kept, (_STEPS, self.dimension)))).mean())

    def _draw(self, n: int) -> AnyFloats:
        if not len(self._centres):
            return super()._draw(n)
        count = int(self.rng.binomial(n, self._part))
        # each hit equally often, so that samples are as even as the hits
        turns = max(1, -(-count // len(self._centres)))
        order = [self.rng.permutation(len(self._centres)) for _ in range(turns)]
        beside = self._beside(self._centres[np.concatenate(order)[:count]])
        return self.rng.permutation(np.concatenate([beside, super()._draw(n - count)[: n - count]]))

    def _beside(self, centres: Floats) -> Mu:
        """Step once from each centre, (n, d), or from some twice where a step is not permitted."""

        def step(count: int) -> Mu:
            around = np.resize(centres, (count, self.dimension))
            moved = around + self.options.width * self.rng.normal(size=around.shape)
            return reflect(moved).astype(np.float32)

        return draw_permitted(step, len(centres), self._permits)
