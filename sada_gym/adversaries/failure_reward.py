"""The rewards of adversaries that learn by reinforcement; they depend on the order of scores."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from sada_gym.adversaries.omega import Omega

MEMORY = 1_000
"""The dissimilarity bonus remembers so many failures, the latest ones."""

Array = npt.NDArray[np.float64]


def failure_rewards(
    asked: Omega, seen: Omega, threshold: float, *, rank: float, dissimilarity: float
) -> Array:
    """Give the rewards of a rollout's queries: (n,).

    A query that fooled gets 1. Any other gets a part of `rank`: the share of all queries that
    missed so far, these included, whose score is above its own (half of the equal ones count). So
    only the order of scores matters, and Q, Q**4 and log Q give the same rewards.

    The dissimilarity bonus (Corso et al. 2019, "Adaptive stress testing with reward augmentation
    for autonomous vehicle validation") is added where a query fooled: `dissimilarity` times its
    `novelties`.

    Args:
        asked: The rollout's queries.
        seen: All queries before it.
        threshold: The fooling threshold.
        rank: The highest reward of a query that did not fool.
        dissimilarity: The weight of the bonus.
    """
    fooled = asked.score <= threshold
    scores = np.concatenate([seen.score, asked.score])
    misses = np.sort(scores[scores > threshold])
    places = sum(np.searchsorted(misses, asked.score, side=side) for side in ("left", "right"))
    above = 1.0 - 0.5 * np.asarray(places, np.float64) / max(len(misses), 1)
    rewards: Array = np.where(fooled, 1.0, rank * above)
    if dissimilarity and fooled.any():
        failures = seen.mu[seen.score <= threshold][-MEMORY:]
        rewards[fooled] += dissimilarity * novelties(asked.mu[fooled], failures)
    return rewards


def novelties(mu: npt.NDArray[np.float32], failures: npt.NDArray[np.float32]) -> Array:
    """Give how far from known failures each mu (n, d) lies: (n,) in [0, 1].

    A distance has no meaning by itself: in eight dimensions every two points are far apart. So it
    is compared to those among the failures themselves, (m, d): the result is the share of them
    whose nearest other failure is closer than the mu's nearest failure. With fewer than two
    failures every mu has novelty 1.
    """
    if len(failures) < 2:
        return np.ones(len(mu))
    tree = KDTree(failures)
    usual = np.sort(tree.query(failures, k=2)[0][:, 1])
    shares: Array = np.searchsorted(usual, tree.query(mu)[0], side="left") / len(usual)
    return shares
