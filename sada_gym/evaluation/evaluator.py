"""The evaluator: scores of (mu, seed) pairs, from the store or from workers, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application
from sada_gym.errors import StoreError, UserError, UserTypeError, WorkerError, refuse_number
from sada_gym.evaluation.store import Context, EvaluationStore
from sada_gym.evaluation.workers import (
    MAX_WORKERS,
    BatchFunction,
    Registered,
    Task,
    WorkerPool,
    score,
)
from sada_gym.parameters import Mu

MAX_CHUNK = 64
"""A chunk is what a crash can cost, so it is no larger than batching needs."""

Problem = str | Application | BatchFunction
"""What can be attacked: an environment id, an application, or a function (n, d) -> (n,)."""


@dataclass(frozen=True)
class _Chunk:
    """What is handed over and committed at a time: rows of a call, with their mu and seeds."""

    rows: npt.NDArray[np.intp]
    mu: Mu
    seeds: list[int]


_Settle = Callable[[_Chunk, npt.NDArray[np.float64]], None]


class Evaluator:
    """Scores (mu, seed) pairs; owns the application, the store and the worker pool.

    Args:
        problem: An environment id, an `Application`, or a function (n, d) -> (n,).
        env_kwargs: Keywords of an environment id.
        dimension: d of a function.
        threshold: The fooling threshold of a function.
        workers: 1 evaluates in this process, more in as many others.
        store: The evaluation store's file; None keeps nothing.
        chunk_size: Evaluations handed over at a time; None chooses.
        executor: Any PEP 3148 executor instead of our own processes; `workers` then says how many
            it has. It is left open.

    Raises:
        TypeError, ValueError: If the arguments do not fit together.
        StoreError: If the store cannot serve.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        env_kwargs: Mapping[str, Any] | None = None,
        dimension: int | None = None,
        threshold: float | None = None,
        workers: int = 1,
        store: str | Path | None = None,
        chunk_size: int | None = None,
        executor: Executor | None = None,
    ) -> None:
        refuse_number("workers", workers, 1, None if executor is not None else MAX_WORKERS)
        if chunk_size is not None:
            refuse_number("chunk_size", chunk_size, 1)
        source: Registered | Application | BatchFunction
        if isinstance(problem, str):
            source = Registered(problem, dict(env_kwargs or {}))
        else:
            source = problem
            if env_kwargs:
                raise UserTypeError(
                    f"Expected env_kwargs only with an environment id, got {dict(env_kwargs)} with "
                    f"{problem!r}. Give them to the application itself."
                )
        self.workers = workers
        self._built_here = isinstance(source, Registered)
        self._scorer = source.build() if isinstance(source, Registered) else source
        self.dimension, self.threshold = _described(self._scorer, dimension, threshold)
        self._task = Task.of(source) if workers > 1 or executor is not None else None
        self._chunk_size = chunk_size
        self._executor = executor
        self._pool: WorkerPool | None = None
        self.store: EvaluationStore | None = None
        if store is not None:
            self.attach(store)

    @property
    def application(self) -> Application | None:
        """The application; None for a function."""
        return self._scorer if isinstance(self._scorer, Application) else None

    def attach(self, path: str | Path) -> None:
        """Keep all scores in a store from now on, and take from it what it knows.

        Args:
            path: The evaluation store's file.

        Raises:
            StoreError: If the store cannot serve, or nothing identifies the scores.
        """
        if self.application is None:
            raise StoreError(
                "Expected no store with a bare function, whose scores nothing identifies. "
                "Make it an Application with a name and a fingerprint, or drop the store."
            )
        context = Context.of(self.application)
        store = EvaluationStore(path)
        try:
            self._context = store.context(context)
        except BaseException:
            store.close()
            raise
        self.store = store

    def evaluate(
        self,
        mu: Mu,
        seeds: Sequence[int],
        report: Callable[[int, int], None],
    ) -> tuple[npt.NDArray[np.float64], int]:
        """Score a batch.

        When it is interrupted, or a chunk fails, what was evaluated by then is in the store.

        Args:
            mu: (n, d) float32, checked.
            seeds: n evaluation seeds.
            report: Called after the look-up and after each committed chunk with the number of
                scores done so far and how many of these the store knew.

        Returns:
            The scores, (n,) float64, and how many of them the store knew.
        """
        scores = np.full(len(mu), np.nan)
        if self.store is not None:
            scores = self.store.lookup(self._context, mu, seeds)
        missing = np.flatnonzero(np.isnan(scores))
        known = done = len(mu) - len(missing)

        def settle(chunk: _Chunk, values: npt.NDArray[np.float64]) -> None:
            nonlocal done
            if self.store is not None:
                self.store.commit(self._context, chunk.mu, chunk.seeds, values)
            scores[chunk.rows] = values
            done += len(values)
            report(done, known)

        if known:
            report(done, known)
        size = self._chunk_size or _chunk_size(len(missing), self.workers)
        parts = [missing[start : start + size] for start in range(0, len(missing), size)]
        chunks = [_Chunk(rows, mu[rows], [seeds[i] for i in rows]) for rows in parts]
        if self._task is not None:
            self._in_parallel(self._task, chunks, settle)
        else:
            for chunk in chunks:
                settle(chunk, score(self._scorer, chunk.mu, chunk.seeds))
        return scores, known

    def _in_parallel(self, task: Task, chunks: Sequence[_Chunk], settle: _Settle) -> None:
        """Hand all chunks out and settle each as it comes back."""
        unsettled: dict[Future[npt.NDArray[np.float64]], _Chunk] = {}
        try:
            executor = self._workers(task)
            # a foreign executor's processes know nothing: there the task carries its payload
            sent = task if self._executor is not None else replace(task, payload=None)
            for chunk in chunks:
                unsettled[executor.submit(sent, chunk.mu, chunk.seeds)] = chunk
            for future in as_completed(list(unsettled)):
                settle(unsettled[future], future.result())
                del unsettled[future]
        except BrokenExecutor as error:
            raise WorkerError(
                "A worker process died: out of memory, killed, or the script that started it "
                "lacks its `if __name__ == '__main__':`. What was evaluated before is kept; run "
                "again, with fewer workers if memory was short."
            ) from error
        finally:
            for future, chunk in unsettled.items():
                if not future.cancel() and future.done() and future.exception() is None:
                    settle(chunk, future.result())

    def _workers(self, task: Task) -> Executor:
        """Give the executor; our own processes start when the first chunk needs them."""
        if self._executor is not None:
            return self._executor
        if self._pool is None:
            self._pool = WorkerPool(self.workers, task)
        return self._pool.executor

    def close(self, *, now: bool = False) -> None:
        """Stop the workers and close the store; calling it twice is fine.

        Args:
            now: Drop what the workers are at, instead of waiting for it.
        """
        if self._pool is not None:
            self._pool.close(now=now)
            self._pool = None
        if self.store is not None:
            self.store.close()
        if self._built_here and self.application is not None:
            self.application.close()


def _chunk_size(count: int, workers: int) -> int:
    """Split a call so that every worker gets at least two chunks, against stragglers."""
    if workers == 1:
        return MAX_CHUNK
    return max(1, min(MAX_CHUNK, -(-count // (2 * workers))))


def _described(
    scorer: Application | BatchFunction, dimension: int | None, threshold: float | None
) -> tuple[int, float]:
    if isinstance(scorer, Application):
        if dimension is not None or threshold is not None:
            raise UserTypeError(
                f"Expected dimension and threshold only with a function; {scorer.name} has its "
                "own. Drop them."
            )
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
    if dimension < 1 or not np.isfinite(threshold):
        raise UserError(
            "Expected a dimension of at least 1 and a finite threshold, got "
            f"dimension={dimension}, threshold={threshold}."
        )
    return dimension, float(threshold)
