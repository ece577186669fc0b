"""Hits, the queries that fooled, and how sure it is that a world close to one fools again."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from sada_gym.adversaries.models.arrays import Bools, Floats, Indices

_MAX_CHECKS = 2
MIN_NEAR = 3
_BETWEEN = (0.3, 0.7)
"""Where a query between two hits goes, from one to the other."""


class Hits:
    """The queries that fooled, and what the queries close to them say of the chance to do so again.

    A hit may have been luck. A later hit within the radius of an earlier one is no hit of its own:
    it checks the earlier one.

    Args:
        mu: All queries in their order, (n, d).
        fooled: Which of them fooled, (n,).
        predicted: The chance that each fools, predicted without it, (n,).
        radius: How close a query is that checks a hit.

    Attributes:
        mu: The hits, (h, d).
        chance: Their chances to fool again: the mean of the prediction and of the outcomes at the
            hit and within the radius, (h,).
    """

    def __init__(self, mu: Floats, fooled: Bools, predicted: Floats, radius: float) -> None:
        checked = np.zeros(len(mu), bool)
        hits, queries, fooling = [], [], []
        rows = np.flatnonzero(fooled)
        for row, close in zip(rows, KDTree(mu).query_ball_point(mu[rows], radius), strict=True):
            if not checked[row]:
                checked[close] = True
                hits.append(row)
                queries.append(len(close))
                fooling.append(fooled[close].sum())
        self.mu = mu[hits]
        self._queries = np.array(queries)
        self.chance: Floats = (predicted[hits] + np.array(fooling)) / (1.0 + self._queries)

    def most_in_doubt(self, count: int) -> Floats:
        """Choose the hits to check, at most twice as many as there are: (m, d).

        Each check goes where chance (1 - chance) is highest, for so many queries close by.
        """
        doubt, queries = self.chance * (1.0 - self.chance), self._queries.astype(np.float64)
        chosen = []
        for _ in range(min(count, _MAX_CHECKS * len(self.mu))):
            chosen.append(int(np.argmax(doubt / (1.0 + queries))))
            queries[chosen[-1]] += 1.0
        return self.mu[np.array(chosen, np.intp)]

    def kept(self, chance: float) -> Floats:
        """Return the hits of at least a chance: (m, d)."""
        return self.mu[self.chance >= chance]


def between(hits: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Go from hits, (h, d), each about as often as any other, to one of those nearest to them.

    There have to be more than `MIN_NEAR` hits. The result is (count, d).
    """
    nearest = KDTree(hits).query(hits, k=1 + MIN_NEAR)[1][:, 1:]
    rows = np.resize(rng.permutation(len(hits)), count)
    others = nearest[rows, rng.integers(MIN_NEAR, size=count)]
    way = rng.uniform(*_BETWEEN, (count, 1))
    moved: Floats = hits[rows] + way * (hits[others] - hits[rows])
    return moved


def in_turn(count: int, hits: int, rng: np.random.Generator) -> Indices:
    """Choose hits, each about as often as any other, in a new order each time round: (count,)."""
    turns = max(1, -(-count // hits))
    return np.concatenate([rng.permutation(hits) for _ in range(turns)])[:count]
