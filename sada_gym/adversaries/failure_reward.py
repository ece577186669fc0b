"""What an adversary that learns by reinforcement is paid for a query, on no scale of Q's own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from sada_gym.adversaries.omega import Omega

MEMORY = 1_000
"""How many failures the dissimilarity bonus remembers: the latest ones."""

Array = npt.NDArray[np.float64]


def failure_rewards(
    asked: Omega, seen: Omega, threshold: float, *, rank: float, dissimilarity: float
) -> Array:
    """Pay for the queries of a rollout: (n,).

    A query that fooled is paid 1. Any other is paid a part of `rank`: the share of all queries
    that missed so far, these included, whose score is above its own (of equal ones half). So a
    score counts by its order alone, and Q, Q**4 and log Q pay the same.

    The dissimilarity bonus (Corso et al. 2019, "Adaptive stress testing with reward augmentation
    for autonomous vehicle validation") is added where a query fooled: `dissimilarity` times its
    `novelties`.

    Args:
        asked: The rollout's queries.
        seen: All queries before it.
        threshold: The fooling threshold.
        rank: The most that a query is paid that did not fool.
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
    """Tell how far from known failures each mu (n, d) lies: (n,) in [0, 1].

    A distance has no meaning by itself: in eight dimensions every two points are far apart. So it
    is compared to those among the failures themselves, (m, d): the result is the share of them
    whose nearest other failure is closer than the mu's nearest failure. With fewer than two
    failures everything is new.
    """
    if len(failures) < 2:
        return np.ones(len(mu))
    tree = KDTree(failures)
    usual = np.sort(tree.query(failures, k=2)[0][:, 1])
    shares: Array = np.searchsorted(usual, tree.query(mu)[0], side="left") / len(usual)
    return shares
