"""Omega, the evaluated pool of mu, and the inducer that picks the induced set S out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sada_gym.adversaries.base import Query
from sada_gym.errors import BudgetTooSmall, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.parameters import Mu

FALLBACK_SIZE = 100
"""The size of S where no point fools: the paper's s."""


@dataclass(frozen=True)
class InducedSet:
    """The induced set S and the rest of Omega.

    Attributes:
        chosen: (s, d), the points of S, the virtual samples from the fooling distribution.
        rest: (n, d), the points of Omega that do not fool.
        fallback: True where no point fooled, and S holds the lowest scores instead.
    """

    chosen: Mu
    rest: Mu
    fallback: bool


def evaluate(mu: Mu, oracle: Query) -> Evaluations:
    """Query the oracle about mu, (n, d).

    Raises:
        ValueError: If a score is not finite.
    """
    score = np.asarray(oracle(mu), dtype=np.float64)
    if score.shape != (len(mu),) or not np.isfinite(score).all():
        raise UserError(
            f"Expected {len(mu)} finite scores, got shape {score.shape} with "
            f"{int((~np.isfinite(score)).sum())} NaN or infinite. Mend the score function."
        )
    return Evaluations.unseeded(mu, score)


def draw_uniform(n: int, dimension: int, rng: np.random.Generator) -> Mu:
    """Draw n uniform mu: (n, d) in [-1, 1]."""
    return rng.uniform(-1.0, 1.0, (n, dimension)).astype(np.float32)


def evaluate_uniform(
    n: int, dimension: int, oracle: Query, rng: np.random.Generator
) -> Evaluations:
    """Query the oracle about n uniform mu (Omega_0 in the paper).

    Raises:
        ValueError: If n is below 1, or a score is not finite.
    """
    if n < 1:
        raise BudgetTooSmall(f"Expected a budget of at least 1 query to learn from, got {n}.")
    return evaluate(draw_uniform(n, dimension, rng), oracle)


def select_fooling(
    queries: Evaluations, threshold: float, rng: np.random.Generator, *, size: int | None = None
) -> InducedSet:
    """Pick the lowest-scoring points of Omega with Q <= threshold (the paper's inducer).

    Args:
        queries: The evaluated pool.
        threshold: The fooling threshold epsilon.
        rng: Breaks the ties among equal scores.
        size: s, the most points to pick; None picks all that fool.
    """
    shuffled = rng.permutation(len(queries))
    order = shuffled[np.argsort(queries.score[shuffled], kind="stable")]
    fooling = int(queries.fooled(threshold).sum())
    count = fooling or min(size or FALLBACK_SIZE, len(queries))
    chosen = order[: min(size or count, count)]
    return InducedSet(queries.mu[chosen], queries.mu[order[count:]], fallback=fooling == 0)
