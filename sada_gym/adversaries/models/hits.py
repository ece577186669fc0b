"""Hits, the queries that fooled, and how sure it is that a world close to one fools again."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from sada_gym.adversaries.models.arrays import Bools, Floats, Indices

_MAX_CHECKS = 2
MIN_NEAR = 3
"""How many of the nearest hits a query between two hits may go to."""
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
        tree = KDTree(mu)
        for row in np.flatnonzero(fooled):
            if not checked[row]:
                # one by one: where the radius is large, all lists at once would not fit memory
                close = tree.query_ball_point(mu[row], radius)
                checked[close] = True
                hits.append(row)
                queries.append(len(close))
                fooling.append(fooled[close].sum())
        self.mu = mu[hits]
        self._queries = np.array(queries)
        self.chance: Floats = (predicted[hits] + np.array(fooling)) / (1.0 + self._queries)

    def most_in_doubt(self, count: int) -> Floats:
        """Choose the hits to check, at most twice as many as there are: (m, d).

        Each check goes where chance (1 - chance) / (1 + queries close by) is highest, and then
        counts as a query close by.
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
    """Choose points between a hit of (h, d) and one of those nearest to it: (count, d).

    Each hit has about as many as any other. There have to be more than `MIN_NEAR` hits.
    """
    nearest = KDTree(hits).query(hits, k=1 + MIN_NEAR)[1][:, 1:]
    rows = np.resize(rng.permutation(len(hits)), count)
    others = nearest[rows, rng.integers(MIN_NEAR, size=count)]
    way = rng.uniform(*_BETWEEN, (count, 1))
    moved: Floats = hits[rows] + way * (hits[others] - hits[rows])
    return moved


def in_turn(count: int, hits: int, rng: np.random.Generator) -> Indices:
    """Choose of so many hits, each about as often, in a new order each time round: (count,)."""
    turns = max(1, -(-count // hits))
    return np.concatenate([rng.permutation(hits) for _ in range(turns)])[:count]
