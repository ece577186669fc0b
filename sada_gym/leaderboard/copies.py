"""Tells samples that were copied from the shipped reference points, shaken or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from sada_gym.parameters import Mu

DISPLACEMENTS = 20
"""The number of random displacements that each sample is compared with."""

STEP = 1.5
"""The length of a displacement, in distances between neighbouring points."""


@dataclass(frozen=True)
class Nearness:
    """How near samples lie to reference points, against the same samples displaced.

    Attributes:
        points: The number of distinct nearest points, of each of which one sample is looked at.
        mean_rank: The mean rank, from 0 to 1, of a sample's distance to its nearest point among the
            distances of its displacements; about 0.5 where the points mean nothing to the samples.
        p: The probability of so low a mean rank, or a lower one, where they mean nothing.
        exact: The number of samples that are a reference point to the last bit.
    """

    points: int
    mean_rank: float
    p: float
    exact: int


def nearness(mu: Mu, points: Mu, *, seed: int = 0) -> Nearness:
    """Compare samples with random displacements of them by their distance to the nearest point.

    The points fill the box evenly, so whoever does not know them comes as near to them here as a
    small step further. One sample is taken for each nearest point: samples that crowd around one
    place say the same over and over. A step that leaves the box is reflected at its face.

    Args:
        mu: The samples, (n, d) float32 in [-1, 1], n >= 1.
        points: All points of the reference set, (R, d) float32, whether they fool or not.
        seed: Fixes the displacements.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points.astype(np.float64))
    distances, nearest = tree.query(mu.astype(np.float64))
    first = np.sort(np.unique(nearest, return_index=True)[1])
    chosen, own = mu[first].astype(np.float64), distances[first]
    rng = np.random.default_rng(seed)
    # in many dimensions the length of such a step hardly varies
    steps = rng.standard_normal((DISPLACEMENTS, *chosen.shape)) / np.sqrt(chosen.shape[1])
    moved = _reflected(chosen + STEP * spacing(points) * steps)
    others = tree.query(moved.reshape(-1, chosen.shape[1]))[0].reshape(DISPLACEMENTS, -1)
    ranks = ((others < own).sum(axis=0) + 0.5 * (others == own).sum(axis=0)) / DISPLACEMENTS
    deviation = (ranks.mean() - 0.5) / np.sqrt((1.0 + 2.0 / DISPLACEMENTS) / 12.0 / len(ranks))
    return Nearness(
        points=len(ranks),
        mean_rank=float(ranks.mean()),
        p=float(norm.cdf(deviation)),
        exact=int((distances == 0.0).sum()),
    )


def spacing(points: Mu) -> float:
    """Give the median distance from a point to its nearest other one."""
    return _spacing(points.astype(np.float64).tobytes(), points.shape[1])


@lru_cache(maxsize=8)
def _spacing(points: bytes, dimension: int) -> float:
    from scipy.spatial import cKDTree

    array = np.frombuffer(points).reshape(-1, dimension)
    return float(np.median(cKDTree(array).query(array[:1_000], k=2)[0][:, 1]))


def _reflected(mu: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Fold positions into [-1, 1] at its ends."""
    return np.abs((mu + 3.0) % 4.0 - 2.0) - 1.0
