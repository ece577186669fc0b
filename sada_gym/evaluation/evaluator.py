"""The evaluator gets scores of (mu, seed) pairs from the store or from workers, in chunks."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from multiprocessing import current_process
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sada_gym.application import INFEASIBLE, Application, check_declared
from sada_gym.errors import (
    Notice,
    SlowWorlds,
    StoreError,
    UserError,
    UserTypeError,
    check_integer,
)
from sada_gym.evaluation.dispatch import Chunk, Dispatcher
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.problems import Answer, BatchFunction, Problem, Registered, score
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.workers import PortableScorer
from sada_gym.foundations.arrays import Bools, Floats, Indices
from sada_gym.foundations.ids import names_file
from sada_gym.measures.rates import wilson_interval
from sada_gym.parameters import Mu

MAX_CHUNK = 64
"""A crash can cost a whole chunk, so a chunk is no larger than batching needs."""
SLOW_S, SLOW_CHUNK_S = 0.5, 30.0
"""Worlds that take longer are slow; a chunk of them takes about so long."""

MOST_INVALID = 0.2
"""The share of invalid worlds from which on nothing can be said about the agent."""

MANY = 20
"""The share of invalid worlds is judged from so many worlds on."""


class Evaluated(NamedTuple):
    """The scores of n worlds, (n,), how many came from the store, and why some are invalid."""

    scores: Floats
    cached: int
    invalid: Mapping[int, str]


class Evaluator:
    """Owns the application, the store and the workers that several oracles can share.

    Arguments and errors are as for `Oracle`.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        env_kwargs: Mapping[str, Any] | None = None,
        dimension: int | None = None,
        threshold: float | None = None,
        workers: int | Workers = 1,
        store: str | Path | None = None,
    ) -> None:
        who = Workers.of(workers)
        if env_kwargs is not None and not isinstance(env_kwargs, Mapping):
            raise UserTypeError(f"Expected env_kwargs to be a dictionary, got {env_kwargs!r}.")
        source: Registered | Application | BatchFunction
        if isinstance(problem, str):
            # a worker may run in another folder
            name = os.path.abspath(problem) if names_file(problem) else problem
            source = Registered(name, dict(env_kwargs or {}))
        else:
            source = problem
            if env_kwargs:
                raise UserTypeError(
                    f"Expected env_kwargs only with an environment id, got {dict(env_kwargs)} with "
                    f"{problem!r}. Give them to the application itself."
                )
        if who.count > 1 and who.executor is None and current_process().daemon:
            # Celery's and multiprocessing.Pool's
            warnings.warn(
                "A daemonic process may start no workers: this one evaluates alone, with the same "
                "result. Pass an executor to have workers: workers=Workers(executor=...).",
                Notice,
                stacklevel=2,
            )
            who = replace(who, count=1)
        self.workers = who.count
        self._built_here = isinstance(source, Registered)
        self._scorer = source.build() if isinstance(source, Registered) else source
        self.dimension, self.threshold = _described(self._scorer, dimension, threshold)
        self._dispatcher: Dispatcher | None = None
        if who.count > 1 or who.executor is not None:
            on_error = "raise" if self.application is None else self.application._on_error
            timeout = None if self.application is None else self.application._timeout
            self._dispatcher = Dispatcher(
                PortableScorer.of(source),
                who.count,
                who.executor,
                on_error=on_error,
                timeout=timeout,
            )
        self._chunk_size, self._most = who.chunk_size, MAX_CHUNK
        self._answered = self._invalid = 0
        self.store: EvaluationStore | None = None
        if store is not None:
            self.attach(store)

    @property
    def application(self) -> Application | None:
        """The application, or None for a function."""
        return self._scorer if isinstance(self._scorer, Application) else None

    def attach(self, path: str | Path) -> None:
        """Keep all further scores in this store file, and take known scores from it.

        Raises a StoreError if the store cannot be used, or nothing identifies the scores.
        """
        if self.application is None:
            raise StoreError(
                "Expected no store with a bare function, whose scores nothing identifies. "
                "Make it an Application with a name and a fingerprint, or drop the store."
            )
        self.detach()
        key = ApplicationKey.of(self.application)
        store = EvaluationStore(path)
        try:
            self._context = store.context(key)
        except BaseException:
            store.close()
            raise
        self.store = store

    def detach(self) -> None:
        """Close the store, if there is one; later scores are not kept."""
        store, self.store = self.store, None
        if store is not None:
            store.close()

    def expect(self, worlds: int) -> None:
        """Warn what so many worlds cost, if they are slow, and commit these in short chunks."""
        seconds = None if self.application is None else self.application.seconds_per_world
        if seconds is None or seconds < SLOW_S or not worlds:
            return
        self._most = max(1, min(MAX_CHUNK, round(SLOW_CHUNK_S / seconds)))
        costs = "" if self.application is None else self.application.costs
        told = f"{cost_text(seconds, worlds, self.workers)} {costs}".rstrip()
        warnings.warn(told, SlowWorlds, stacklevel=2)

    def evaluate(
        self,
        mu: Mu,
        seeds: Sequence[int],
        report: Callable[[int, int], None],
        judged: Bools | None = None,
    ) -> Evaluated:
        """Score mu, (n, d) float32, checked.

        After the look-up and after each committed chunk it calls `report` with the number of
        scores so far, and how many of these came from the store. If it is interrupted, or a chunk
        fails, the store has all scores up to then.

        Raises:
            UserError: If clearly more than `MOST_INVALID` of all worlds so far are invalid, of
                those alone that are `judged`, (n,), where that is given.
        """
        scores = np.full(len(mu), np.nan)
        invalid: dict[int, str] = {}
        if self.store is not None:
            scores = self.store.lookup(self._context, mu, seeds)
            invalid = self.store.invalid(self._context, mu, seeds)
        missing = np.flatnonzero(np.isnan(scores))
        cached = done = len(mu) - len(missing)

        def settle(chunk: Chunk, answer: Answer) -> None:
            nonlocal done
            if self.store is not None:
                self.store.commit(self._context, chunk.mu, chunk.seeds, *answer)
            scores[chunk.rows] = answer.scores
            invalid.update({int(chunk.rows[i]): why for i, why in answer.invalid.items()})
            done += len(answer.scores)
            report(done, cached)
            self._check_valid(mu, chunk.rows, invalid, judged)

        if cached:
            report(done, cached)
            self._check_valid(mu, np.flatnonzero(~np.isnan(scores)), invalid, judged)
        workers = 1 if self._dispatcher is None else self._dispatcher.workers
        size = self._chunk_size or _chunk_size(len(missing), workers, self._most)
        parts = [missing[start : start + size] for start in range(0, len(missing), size)]
        chunks = [Chunk(rows, mu[rows], [seeds[i] for i in rows]) for rows in parts]
        if self._dispatcher is not None:
            self._dispatcher.run(chunks, settle)
        else:
            for chunk in chunks:
                settle(chunk, score(self._scorer, chunk.mu, chunk.seeds))
        return Evaluated(scores, cached, dict(sorted(invalid.items())))

    def _check_valid(
        self, mu: Mu, rows: Indices, known: Mapping[int, str], judged: Bools | None
    ) -> None:
        chosen = (rows if judged is None else rows[judged[rows]]).tolist()
        feasible = [row for row in chosen if known.get(row) != INFEASIBLE]
        broken = [row for row in feasible if row in known]
        self._answered += len(feasible)
        self._invalid += len(broken)
        if not broken or self._answered < MANY:
            return
        if wilson_interval(self._invalid, self._answered)[0] > MOST_INVALID:
            row = broken[0]
            raise too_many_invalid(
                self._invalid, self._answered, self.application, mu[row], known[row]
            )

    def close(self, *, now: bool = False) -> None:
        """Stop the workers and close the store; `now` drops the running chunks."""
        if self._dispatcher is not None:
            self._dispatcher.close(now=now)
        if self.store is not None:
            self.store.close()  # not detached: a later score must not get lost without a word
        if self._built_here and self.application is not None:
            self.application.close()


def too_many_invalid(
    invalid: int, worlds: int, application: Application | None, mu: Mu, reason: str
) -> UserError:
    """Return the error of a run with too many invalid worlds; one has mu, (d,), for this reason."""
    assert application is not None
    return UserError(
        f"Expected at most {MOST_INVALID:.0%} invalid worlds, got {invalid:,} of {worlds:,}. One "
        f"has {application.parameters.text(mu)}: {reason}. Narrow the ranges, leave the region "
        "out by feasible=, or count such worlds as failures of the agent by on_error='fooled'."
    )


def cost_text(seconds: float, worlds: int, workers: int) -> str:
    """Say how long worlds take: `About 3 s a world; 250 worlds: 13 minutes`."""
    total = seconds * worlds / workers
    unit, length = next(
        (
            (unit, length)
            for unit, length in (("hours", 3600), ("minutes", 60))
            if total > 2 * length
        ),
        ("s", 1),
    )
    by = f" by {workers} workers" if workers > 1 else ""
    return f"About {seconds:.2g} s a world; {worlds:,} worlds: {total / length:,.0f} {unit}{by}."


def _chunk_size(count: int, workers: int, most: int = MAX_CHUNK) -> int:
    if workers == 1:
        return most
    # at least two chunks for every worker: a slow one holds up less
    return max(1, min(most, -(-count // (2 * workers))))


def _described(
    scorer: Application | BatchFunction, dimension: int | None, threshold: float | None
) -> tuple[int, float]:
    if isinstance(scorer, Application):
        if dimension is not None or threshold is not None:
            raise UserTypeError(
                f"Expected dimension and threshold only with a function; {scorer.name} has its "
                "own. Drop them."
            )
        check_declared(scorer)
        return len(scorer.parameters), float(scorer.fooling_threshold)
    if not callable(scorer):
        raise UserTypeError(
            "Expected an environment id, an Application or a function (n, d) -> (n,), got "
            f"{scorer!r}."
        )
    if dimension is None or threshold is None:
        raise UserTypeError(
            "Expected dimension= and threshold= with a function, got "
            f"dimension={dimension}, threshold={threshold}. Say what mu's d and epsilon are."
        )
    check_integer("dimension", dimension, 1)
    if not isinstance(threshold, int | float | np.number) or not np.isfinite(threshold):
        raise UserError(f"Expected threshold to be a finite number, got {threshold!r}.")
    return int(dimension), float(threshold)
