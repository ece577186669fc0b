"""The order of a benchmark's jobs: groups side by side, the runs of a group one by one.

The runs of a group share an evaluation store, which one process at a time can have open.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from sada_gym.benchmark.folder import store_file, write_run
from sada_gym.benchmark.job import RunDone, RunError, RunJob, do_run
from sada_gym.benchmark.plan import Group, Plan
from sada_gym.benchmark.progress import BenchmarkCallback, can_read, progress_folder, read_progress
from sada_gym.errors import UserError, WorkerError
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.workers import WorkerPool
from sada_gym.runs.record import RunSettings
from sada_gym.runs.run import RunProgress

_POLL_EVERY_S = 0.25
_DEATHS = 3


class _LostError(Exception):
    """The process that did a run died, and can be replaced."""


class _Workers(Protocol):
    """Where jobs run; a place does one at a time."""

    each: int
    """The number of processes that a job may evaluate in."""

    def visible(self, out: Path, token: str) -> bool:
        """Say whether the workers see the benchmark's folder."""

    def submit(self, place: int, job: RunJob) -> Future[RunDone]:
        """Start a job in a place."""

    def result(self, place: int, future: Future[RunDone]) -> RunDone:
        """Give a finished job's result.

        Raises:
            _LostError: If its process died and the job can be submitted again.
            WorkerError: If the executor cannot go on.
        """

    def close(self) -> None:
        """Drop what is still at work; after the last run that is nothing."""


class _OwnProcesses:
    """A process a place, so that one that dies takes no other with it."""

    def __init__(self, places: int, each: int) -> None:
        self._pools: list[WorkerPool | None] = [None] * places
        self.each = each

    def visible(self, out: Path, token: str) -> bool:  # noqa: ARG002
        return True

    def submit(self, place: int, job: RunJob) -> Future[RunDone]:
        pool = self._pools[place]
        if pool is None:
            pool = self._pools[place] = WorkerPool(1)
        return pool.executor.submit(do_run, job)

    def result(self, place: int, future: Future[RunDone]) -> RunDone:
        try:
            return future.result()
        except BrokenExecutor as error:
            pool, self._pools[place] = self._pools[place], None
            if pool is not None:
                pool.close(now=True)
            raise _LostError from error

    def close(self) -> None:
        for pool in self._pools:
            if pool is not None:
                # not by a common exit: a process that evaluates in others keeps those for its next
                # run, and would wait for them
                pool.close(now=True)


class _AnyExecutor:
    """A user's executor, which replaces its own workers or gives up."""

    each = 1

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._pending: set[Future[RunDone]] = set()

    def visible(self, out: Path, token: str) -> bool:
        try:
            return self._executor.submit(can_read, out, token).result()
        except Exception as error:
            raise _gave_up("a first job", error) from error

    def submit(self, place: int, job: RunJob) -> Future[RunDone]:  # noqa: ARG002
        try:
            future = self._executor.submit(do_run, job)
        except Exception as error:
            raise _gave_up(str(job.settings), error) from error
        self._pending.add(future)
        return future

    def result(self, place: int, future: Future[RunDone]) -> RunDone:  # noqa: ARG002
        self._pending.discard(future)
        return future.result()

    def close(self) -> None:
        for future in self._pending:
            future.cancel()


@dataclass(eq=False)
class _Chain:
    """A group at work: one run after the other, always in the same place."""

    group: Group
    left: deque[RunSettings]
    place: int
    names: tuple[str, ...]

    @property
    def run(self) -> RunSettings:
        """The run that is being done."""
        return self.left[0]


def do_runs(
    plan: Plan,
    missing: Sequence[RunSettings],
    out: Path,
    workers: int,
    executor: Executor | None,
    callback: BenchmarkCallback,
) -> None:
    """Do all missing runs of a plan and put each in its folder.

    Args:
        plan: All runs.
        missing: The runs of the plan to do.
        out: The benchmark's folder, absolute.
        workers: The number of processes to start, or of workers that the executor has.
        executor: The executor that does the runs; None starts our own processes.
        callback: Called as it goes on.

    Raises:
        RunError, StoreError, WorkerError: See `sada_gym.benchmark.run.run_benchmark`.
    """
    wanted = {id(run) for run in missing}
    groups = deque(
        (group, runs)
        for group in plan.groups
        if (runs := deque(run for run in group.runs if id(run) in wanted))
    )
    places, each = min(workers, len(groups)), max(1, workers // len(groups))
    jobs: _Workers = _OwnProcesses(places, each) if executor is None else _AnyExecutor(executor)
    try:
        with progress_folder(out) as token:
            _Schedule(groups, jobs, out, token, callback).do(places)
    finally:
        jobs.close()


class _Schedule:
    """Hands out runs and writes down their results."""

    def __init__(
        self,
        groups: deque[tuple[Group, deque[RunSettings]]],
        jobs: _Workers,
        out: Path,
        token: str,
        callback: BenchmarkCallback,
    ) -> None:
        self._groups, self._jobs, self._out, self._token = groups, jobs, out, token
        self._callback = callback
        self._visible = jobs.visible(out, token)
        self._active: dict[Future[RunDone], _Chain] = {}
        self._deaths = Counter[str]()
        self._last: dict[str, RunProgress] = {}

    def do(self, places: int) -> None:
        """Keep all places busy until nothing is left."""
        for place in range(places):
            self._begin_group(place)
        while self._active:
            done, _ = wait(self._active, timeout=_POLL_EVERY_S, return_when="FIRST_COMPLETED")
            self._poll()
            for future in done:
                self._settle(future, self._active.pop(future))

    def _begin_group(self, place: int) -> None:
        if self._groups:
            group, runs = self._groups.popleft()
            names = tuple(dict.fromkeys(run.adversary for run in runs))
            self._submit(_Chain(group, runs, place, names))

    def _submit(self, chain: _Chain) -> None:
        stored, path = None, store_file(self._out, chain.group)
        if not self._visible:
            self._callback.on_progress(chain.run, RunProgress("train", total=chain.run.budget))
            if path.exists():
                stored = path.read_bytes()
        job = RunJob(
            settings=chain.run,
            keywords=chain.group.keywords,
            fooling_set=chain.group.fooling_set,
            ideal_set=chain.group.ideal_set,
            workers=self._jobs.each,
            adversaries=chain.names,
            out=self._out,
            token=self._token,
            stored=stored,
        )
        self._active[self._jobs.submit(chain.place, job)] = chain

    def _poll(self) -> None:
        """Pass on the progress that the workers wrote since the last time."""
        for chain in self._active.values() if self._visible else ():
            name, progress = str(chain.run), read_progress(self._out, chain.run)
            if progress is not None and progress != self._last.get(name):
                self._last[name] = progress
                self._callback.on_progress(chain.run, progress)

    def _settle(self, future: Future[RunDone], chain: _Chain) -> None:
        """Write a finished run and go on with the next, or do a lost one again."""
        try:
            done = self._jobs.result(chain.place, future)
        except _LostError as error:
            self._count_death(chain.run, error)
        except (RunError, UserError, WorkerError):
            raise
        except (Exception, CancelledError) as error:
            raise _gave_up(str(chain.run), error) from error
        else:
            self._keep(chain.group, done)
            write_run(self._out, done.result, done.timing, done.samples, done.picture)
            self._callback.on_finish(chain.left.popleft(), done.timing)
        if chain.left:
            self._submit(chain)
        else:
            self._begin_group(chain.place)

    def _keep(self, group: Group, done: RunDone) -> None:
        """Store what a worker evaluated that doesn't see the folder."""
        if done.evaluations:
            path = store_file(self._out, group)
            path.parent.mkdir(parents=True, exist_ok=True)
            with EvaluationStore(path) as store:
                context = store.context(done.context)
                for part in done.evaluations:
                    store.commit(context, part.mu, part.seed.tolist(), part.score)

    def _count_death(self, run: RunSettings, error: Exception) -> None:
        self._deaths[str(run)] += 1
        if self._deaths[str(run)] >= _DEATHS:
            raise WorkerError(
                f"The process of {run} died {_DEATHS} times: out of memory, or killed. What is "
                "finished is kept; run the same command again, with fewer workers if memory was "
                "short."
            ) from error


def _gave_up(what: str, error: BaseException) -> WorkerError:
    return WorkerError(
        f"The executor gave up on {what} ({type(error).__name__}: {error}). What is finished is "
        "kept; run the same command again when its workers are back."
    )
