"""Finds samples that were copied from the shipped reference points, moved a little or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm

from sada_gym.measures.reference import reference_mu
from sada_gym.parameters import Mu

OTHER_SETS = 20  #: How many other point sets, made alike, the shipped one is compared with.
_FIRST_SEED = 1_000_000  # no shipped set has such a seed


@dataclass(frozen=True)
class Nearness:
    """How near samples lie to reference points, compared with other sets of the same kind.

    Attributes:
        points: The number of distinct nearest points; one sample of each counts.
        mean_rank: The mean rank, from 0 to 1, of a sample's distance to its nearest point among its
            distances to other sets; about 0.5 for samples that do not come from the points.
        p: The probability that such samples have so low a mean rank, or a lower one.
        exact: The number of samples that are a reference point to the last bit.
    """

    points: int
    mean_rank: float
    p: float
    exact: int


def nearness(mu: Mu, points: Mu, *, seed: int = 0) -> Nearness:
    """Compare how near samples lie to the shipped points and to other sets of the same kind.

    The sets differ in the scrambling of their Sobol sequence alone. So samples that were made
    without the shipped points lie as near to the other sets, wherever they lie. One sample counts
    for each nearest point, because samples that crowd around one place all say the same.

    `mu` is (n, d) float32 in [-1, 1], n >= 1, and `points` are all points of the reference set,
    (R, d) float32, whether they fool or not. The seed fixes the other sets.
    """
    tree = cKDTree(points.astype(np.float64))
    distances, nearest = tree.query(mu.astype(np.float64))
    first = np.sort(np.unique(nearest, return_index=True)[1])
    chosen, own = mu[first].astype(np.float64), distances[first]
    others = np.stack([other.query(chosen)[0] for other in _other_sets(*points.shape, seed)])
    ranks = ((others < own).sum(axis=0) + 0.5 * (others == own).sum(axis=0)) / OTHER_SETS
    deviation = (ranks.mean() - 0.5) / np.sqrt((1.0 + 2.0 / OTHER_SETS) / 12.0 / len(ranks))
    return Nearness(
        points=len(ranks),
        mean_rank=float(ranks.mean()),
        p=float(norm.cdf(deviation)),
        exact=int((distances == 0.0).sum()),
    )


def spacing(points: Mu) -> float:
    """Return the median distance from a point to its nearest other one."""
    array = points.astype(np.float64)
    return float(np.median(cKDTree(array).query(array[:1_000], k=2)[0][:, 1]))


@lru_cache(maxsize=2)
def _other_sets(count: int, dimension: int, seed: int) -> list[Any]:
    first = _FIRST_SEED + seed * OTHER_SETS
    sets = (reference_mu(dimension, count, first + i) for i in range(OTHER_SETS))
    return [cKDTree(mu.astype(np.float64)) for mu in sets]
