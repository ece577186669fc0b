"""Scores of worlds outside of a run's own streams, kept in a store, and failures tried again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Integers
from sada_gym.parameters import Mu

OnScores = Callable[[int, int, int], object]
"""Gets the number of scores so far, of all that are asked for, and of those from the store."""


class InParts:
    """Counts the scores of several evaluations, `total` in all, as those of one."""

    def __init__(self, on_scores: OnScores, total: int) -> None:
        self._on_scores, self._total = on_scores, total
        self._done = self._cached = 0

    def __call__(self, done: int, total: int, cached: int) -> None:
        """Report the scores of the present evaluation; with all of them the next one begins."""
        self._on_scores(self._done + done, self._total, self._cached + cached)
        if done == total:
            self._done, self._cached = self._done + done, self._cached + cached


def stored_scores(
    evaluator: Evaluator,
    mu: Mu,
    seeds: Sequence[int],
    store: Path | None,
    on_scores: OnScores,
    judged: Bools | None = None,
) -> Evaluations:
    """Score mu, (n, d), with n seeds, and keep the scores in a store.

    Without a store, or for an application that nothing identifies, none is kept. For `judged` see
    `Evaluator.evaluate`.
    """

    def report(done: int, cached: int) -> None:
        on_scores(done, len(mu), cached)

    known = evaluator.application is not None and evaluator.application.fingerprint is not None
    if store is not None and known:
        evaluator.attach(store)
    try:
        answer = evaluator.evaluate(mu, seeds, report, judged)
    finally:
        evaluator.detach()
    invalid = np.zeros(len(mu), np.bool_)
    invalid[[*answer.invalid]] = True
    return Evaluations(mu, answer.scores, np.array(seeds, np.int64), invalid)


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
        on_scores: Gets the number of scores so far, of all, and of those from the store.
    """
    each = len(seeds[0]) if seeds else 0
    listed = [seed for own in seeds for seed in own]
    scored = stored_scores(evaluator, np.repeat(mu, each, axis=0), listed, store, on_scores)
    shape = len(mu), each
    return FreshScores(scored.fooled(threshold).reshape(shape), scored.invalid.reshape(shape))
