"""Omega, the evaluated pool of mu, and the inducer that picks the induced set S out of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sada_gym.adversaries.base import Query
from sada_gym.errors import AdversaryError, BudgetTooSmall, UserError
from sada_gym.evaluations import Evaluations
from sada_gym.parameters import Mu, Permits

FALLBACK_SIZE = 100
"""The size of S where no point fools: the paper's s."""


@dataclass(frozen=True)
class InducedSet:
    """The induced set S, `chosen` (s, d), and the points of Omega that do not fool, `rest` (n, d).

    S are the points that fool. If none did, it holds the lowest scores, and `fallback` is true.
    """

    chosen: Mu
    rest: Mu
    fallback: bool


def evaluate(mu: Mu, oracle: Query) -> Evaluations:
    """Query the oracle at mu, (n, d); raise `UserError` if a score is not finite."""
    score = np.asarray(oracle(mu), dtype=np.float64)
    if score.shape != (len(mu),) or not np.isfinite(score).all():
        raise UserError(
            f"Expected {len(mu)} finite scores, got shape {score.shape} with "
            f"{int((~np.isfinite(score)).sum())} NaN or infinite. Fix the score function."
        )
    return Evaluations.unseeded(mu, score)


_DRAWN_EACH = 4_000
"""Points drawn for each that a feasible region must hold: 1 in 1,000 is the least that works."""


def draw_permitted(draw: Callable[[int], Mu], n: int, permits: Permits) -> Mu:
    """Call `draw` until n mu are permitted by `permits`, see `Oracle.permits`: (n, d).

    Raises:
        AdversaryError: If hardly any mu is permitted.
    """
    drawn_first = draw(n)
    kept = [drawn_first[permits(drawn_first)]]
    count, drawn = len(kept[0]), n
    while count < n:
        if drawn > _DRAWN_EACH * (n + 10):
            raise AdversaryError(
                f"Expected {n:,} mu in the region that feasible= allows, got {count:,} of "
                f"{drawn:,} drawn. Shrink the ranges to that region."
            )
        more = draw(n)
        kept.append(more[permits(more)])
        count, drawn = count + len(kept[-1]), drawn + n
    return np.concatenate(kept)[:n]


def draw_uniform(n: int, dimension: int, rng: np.random.Generator) -> Mu:
    """Draw n uniform mu: (n, d) in [-1, 1]."""
    return rng.uniform(-1.0, 1.0, (n, dimension)).astype(np.float32)


def evaluate_uniform(
    n: int, dimension: int, oracle: Query, rng: np.random.Generator
) -> Evaluations:
    """Query the oracle at n uniform mu, n >= 1 (Omega_0 in the paper).

    If the oracle has a feasible region, they are uniform in that region.
    """
    if n < 1:
        raise BudgetTooSmall(f"Expected a budget of at least 1 query to learn from, got {n}.")
    drawn = draw_permitted(lambda count: draw_uniform(count, dimension, rng), n, oracle.permits)
    return evaluate(drawn, oracle)


def select_fooling(
    queries: Evaluations, threshold: float, rng: np.random.Generator, *, size: int | None = None
) -> InducedSet:
    """Select the points of Omega that fool, at most the `size` lowest (the paper's inducer).

    Without `size`, all that fool are selected. Ties between equal scores are broken at random.
    """
    shuffled = rng.permutation(len(queries))
    order = shuffled[np.argsort(queries.score[shuffled], kind="stable")]
    fooling = int(queries.fooled(threshold).sum())
    count = fooling or min(size or FALLBACK_SIZE, len(queries))
    chosen = order[: min(size or count, count)]
    return InducedSet(queries.mu[chosen], queries.mu[order[count:]], fallback=fooling == 0)
