"""Hands chunks of evaluations to an executor, and repeats those whose worker died."""

from __future__ import annotations

import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sada_gym.application import INVALID_SCORE, OnError
from sada_gym.errors import WorkerError
from sada_gym.evaluation import watch
from sada_gym.evaluation.executors import count_workers, engine_errors, lost_its_worker
from sada_gym.evaluation.problems import Answer
from sada_gym.evaluation.workers import PortableScorer, WorkerPool, evaluate_if_loadable
from sada_gym.parameters import Mu

MAX_DEATHS = 3
"""Workers may die this often while a chunk is under way; then the chunk counts as the cause."""

_AHEAD = 2
"""Chunks handed out for each worker: it evaluates one, and the other waits.

More would not make it faster, but would cost more memory, and more work at a Ctrl-C.
"""
_SMALL_BYTES = 4096
"""A payload of at most this size is sent with every chunk."""
_CHECK_S = 5.0
_NO_WORKER_S = 300.0
_DYING_S = 10.0
_DEATHS_IN_ONE_WORLD = 2
"""A world counts as the cause when so many workers died in it: one may have been killed."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """The unit that is evaluated and committed together: rows of a call, their mu and seeds."""

    rows: npt.NDArray[np.intp]
    mu: Mu
    seeds: list[int]

    @property
    def keys(self) -> list[int]:
        """The keys of its worlds, see `watch`."""
        return [watch.world_key(*world) for world in zip(self.mu, self.seeds, strict=True)]

    def part(self, positions: list[int]) -> Chunk:
        """Return the chunk of some of its worlds."""
        return Chunk(self.rows[positions], self.mu[positions], [self.seeds[i] for i in positions])


Settle = Callable[[Chunk, Answer], None]
Pending = dict[Future[Answer | None], Chunk]
"""The chunks that were handed out; None as the result of one asks for the task's payload."""


class Dispatcher:
    """Hands chunks to an executor, a few for each worker, and collects their scores.

    Without an executor the first chunk starts our own processes. When one of them dies, all are
    replaced, and their chunks are evaluated again. What they warn of is shown here, once. Other
    executors replace their workers themselves, or give up; they are left open. `workers` counts
    our own processes, or those of an executor that cannot say how many it has.

    `on_error` says what becomes of a world in which our processes die again and again, or which
    takes one longer than `timeout` seconds.
    """

    def __init__(
        self,
        task: PortableScorer,
        workers: int,
        executor: Executor | None = None,
        *,
        on_error: OnError = "raise",
        timeout: float | None = None,
    ) -> None:
        self._on_error, self._timeout = on_error, timeout
        self._died_in = Counter[int]()  # both by the worlds' keys
        self._overdue: set[int] = set()
        self._task = task
        self._default_workers = workers
        self._executor = executor
        self._pool: WorkerPool | None = None
        self._payloads_to_send = 0
        self._counted: int | None = None
        self._counted_at = -_CHECK_S
        self._shown: set[tuple[type[Warning], str]] = set()

    @property
    def workers(self) -> int:
        """The number of workers. A cluster is asked again every few seconds."""
        if self._executor is not None and time.monotonic() - self._counted_at > _CHECK_S:
            self._counted, self._counted_at = count_workers(self._executor), time.monotonic()
        return self._counted or self._default_workers

    def run(self, chunks: Iterable[Chunk], settle: Settle) -> None:
        """Evaluate all chunks; `settle` gets each with its scores, in the order of their return.

        It raises `WorkerError` if workers die again and again, or a cluster is gone. `settle` gets
        all scores that came back before this or any other error.
        """
        waiting, deaths = deque(chunks), Counter[Chunk]()
        pending: Pending = {}
        ahead = _AHEAD * self.workers
        self._payloads_to_send = self.workers
        try:
            while waiting or pending:
                try:
                    self._submit(waiting, pending, ahead)
                    self._collect(waiting, pending, settle)
                except engine_errors() as error:
                    lost = _collect_lost(pending, settle)
                    died = self._recover(error, lost or [waiting[0]], deaths)
                    for chunk in reversed(lost):
                        waiting.extendleft(reversed(self._without(chunk, died, settle)))
        finally:
            for future, chunk in pending.items():
                if not future.cancel():
                    _settle_if_done(future, chunk, settle)

    def _submit(self, waiting: deque[Chunk], pending: Pending, ahead: int) -> None:
        executor = self._open()
        while waiting and len(pending) < ahead:
            chunk = waiting[0]
            try:
                future = executor.submit(
                    evaluate_if_loadable, self._scorer_to_send(), chunk.mu, chunk.seeds
                )
            except BrokenExecutor:
                raise
            except RuntimeError as error:
                raise WorkerError(
                    f"Expected an open executor, got one that takes no more work ({error}). Keep "
                    "it open as long as the oracle is used."
                ) from error
            pending[future] = waiting.popleft()

    def _scorer_to_send(self) -> PortableScorer:
        """Leave the payload out where it is large and the worker has it, or asks for it by None."""
        if self._executor is not None:
            if self._task.size <= _SMALL_BYTES:
                return self._task
            if self._payloads_to_send > 0:
                self._payloads_to_send -= 1  # at first it is sent once for each worker
                return self._task
        return replace(self._task, payload=None)

    def _collect(self, waiting: deque[Chunk], pending: Pending, settle: Settle) -> None:
        for future in self._wait(pending):
            chunk = pending[future]
            try:
                scores = future.result()
            except (TypeError, ValueError) as error:
                if not lost_its_worker(error):
                    raise
                scores = None  # evaluated again, by a worker that may lack the payload
            del pending[future]
            self._show_warnings()
            if scores is None:
                self._payloads_to_send += 1
                waiting.appendleft(chunk)
            else:
                settle(chunk, scores)

    def _show_warnings(self) -> None:
        for category, text in () if self._pool is None else self._pool.warnings():
            if (category, text) not in self._shown:
                self._shown.add((category, text))
                warnings.warn(text, category, stacklevel=2)

    def _wait(self, pending: Pending) -> Iterable[Future[Answer | None]]:
        """Wait for the next results, but not for ever for a cluster that has no workers."""
        last_seen = time.monotonic()
        patience = _CHECK_S if self._timeout is None else min(_CHECK_S, self._timeout / 4)
        while True:
            done, _ = wait(pending, timeout=patience, return_when=FIRST_COMPLETED)
            if done:
                return done
            if self._pool is not None and self._timeout is not None:
                self._overdue |= self._pool.stop_overdue(self._timeout)
            if self._executor is None or count_workers(self._executor) != 0:
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > _NO_WORKER_S:
                raise WorkerError(
                    f"Expected workers in the cluster, but for {_NO_WORKER_S / 60:.0f} minutes "
                    "there was none. What was evaluated before is kept; start workers and resume "
                    "the run."
                )

    def _recover(
        self, error: BaseException, suspects: list[Chunk], deaths: Counter[Chunk]
    ) -> dict[int, str]:
        """Stop what is left of the workers; say how some died in a world, by its key."""
        if self._executor is not None:
            raise WorkerError(
                "The executor lost its workers, or the connection to its scheduler, and gave the "
                f"evaluations up ({type(error).__name__}). What was evaluated before is kept; "
                "start it again and resume the run."
            ) from error
        hopeless = self._pool is not None and self._pool.failed_to_start
        died = {} if self._pool is None else self._pool.deaths()
        self.close(now=True)
        self._died_in.update(died.keys())
        keys = {key for chunk in suspects for key in chunk.keys}
        if died := {key: how for key, how in died.items() if key in keys}:
            return died
        deaths.update(suspects)
        if hopeless or max(deaths.values()) >= MAX_DEATHS:
            raise WorkerError(
                "A worker process died: out of memory, killed, or the script that started it "
                "lacks its `if __name__ == '__main__':`. What was evaluated before is kept; run "
                "again, with fewer workers if memory was short."
            ) from error
        return {}

    def _without(self, chunk: Chunk, died: dict[int, str], settle: Settle) -> list[Chunk]:
        """Split off the worlds in which workers died; settle those that are the cause."""
        keys = chunk.keys
        rest = [i for i, key in enumerate(keys) if key not in died]
        if len(rest) == len(keys):
            return [chunk]
        parts = [chunk.part(rest)] if rest else []
        for i, key in enumerate(keys):
            world = chunk.part([i])
            if key in self._overdue:
                settle(world, self._broken(world, f"it took longer than {self._timeout:g} s"))
            elif self._died_in[key] >= _DEATHS_IN_ONE_WORLD:
                settle(world, self._broken(world, f"the process that computed it {died[key]}"))
            elif key in died:
                parts.insert(0, world)  # again, alone
        return parts

    def _broken(self, world: Chunk, reason: str) -> Answer:
        if self._on_error == "raise":
            raise WorkerError(
                f"Expected every world to be computed, but of mu = {world.mu[0].tolist()} with "
                f"seed {world.seeds[0]}, {reason}. What was evaluated before is kept. Narrow the "
                "ranges, or let on_error='invalid' go on without such worlds."
            )
        if self._on_error == "fooled":
            return Answer(np.zeros(1))
        return Answer(np.full(1, INVALID_SCORE), {0: reason})

    def _open(self) -> Executor:
        if self._executor is not None:
            return self._executor
        if self._pool is None:
            self._pool = WorkerPool(self._default_workers, self._task)
        return self._pool.executor

    def close(self, *, now: bool = False) -> None:
        """Stop our own processes, `now` without waiting for running chunks; twice is fine."""
        if self._pool is not None:
            self._pool.close(now=now)
            self._pool = None


def _collect_lost(pending: Pending, settle: Settle) -> list[Chunk]:
    """Empty `pending` after a death: settle the finished chunks, and return the others."""
    wait(pending, timeout=_DYING_S)  # a pool that has lost a process fails all that it holds
    lost = []
    while pending:
        future, chunk = pending.popitem()
        if not _settle_if_done(future, chunk, settle):
            lost.append(chunk)
    return lost[::-1]


def _settle_if_done(future: Future[Answer | None], chunk: Chunk, settle: Settle) -> bool:
    """Settle a chunk whose scores have come back, and return whether they have."""
    if not future.done() or future.cancelled() or future.exception() is not None:
        return False
    scores = future.result()
    if scores is None:
        return False
    settle(chunk, scores)
    return True
