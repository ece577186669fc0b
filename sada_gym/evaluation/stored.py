"""Scores of worlds outside of a run's own streams, kept in a store, and failures tried again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Bools, Floats, Integers
from sada_gym.parameters import Mu

OnScores = Callable[[int, int, int], object]
"""Gets the number of scores so far, of all that are asked for, and of those from the store."""


def stored_scores(
    evaluator: Evaluator,
    mu: Mu,
    seeds: Sequence[int],
    store: Path | None,
    report: Callable[[int, int], None],
) -> tuple[Floats, Bools]:
    """Score mu, (n, d), with n seeds, and keep the scores in a store.

    Without a store, or for an application that nothing identifies, none is kept.

    Returns:
        The scores, (n,), and which worlds are invalid, (n,).
    """
    known = evaluator.application is not None and evaluator.application.fingerprint is not None
    if store is not None and known:
        evaluator.attach(store)
    try:
        answer = evaluator.evaluate(mu, seeds, report)
    finally:
        evaluator.detach()
    invalid = np.zeros(len(mu), np.bool_)
    invalid[[*answer.invalid]] = True
    return answer.scores, invalid


@dataclass(frozen=True, eq=False)
class FreshScores:
    """Worlds that were tried again: `fooled` and `invalid` are (n worlds, k seeds) bool.

    Where a world is invalid, it fooled nobody.
    """

    fooled: Bools
    invalid: Bools

    @property
    def fooled_seeds(self) -> Integers:
        """The number of seeds with which each world fooled, (n,)."""
        return np.asarray(self.fooled.sum(axis=1))

    @property
    def valid_seeds(self) -> Integers:
        """The number of seeds with which each world is valid, (n,)."""
        return np.asarray((~self.invalid).sum(axis=1))

    @property
    def fails(self) -> Bools:
        """Which worlds fool with more than half of their valid seeds, (n,)."""
        return np.asarray(2 * self.fooled_seeds > self.valid_seeds)


def try_again(
    evaluator: Evaluator,
    mu: Mu,
    seeds: Sequence[Sequence[int]],
    threshold: float,
    store: Path | None,
    on_scores: OnScores,
) -> FreshScores:
    """Evaluate each of n worlds, (n, d), with k seeds of its own, and keep the scores in a store.

    Args:
        evaluator: Scores the worlds.
        mu: The worlds.
        seeds: Those of each world, equally many.
        threshold: The agent is fooled where Q is at most this.
        store: See `stored_scores`.
        on_scores: See `OnScores`.
    """
    each = len(seeds[0]) if seeds else 0
    listed = [seed for own in seeds for seed in own]

    def report(done: int, cached: int) -> None:
        on_scores(done, len(listed), cached)

    score, invalid = stored_scores(evaluator, np.repeat(mu, each, axis=0), listed, store, report)
    fooled = fools(score, threshold) & ~invalid
    return FreshScores(fooled.reshape(len(mu), each), invalid.reshape(len(mu), each))
