"""The order of a benchmark's jobs: groups side by side, the runs of a group one by one.

The runs of a group share an evaluation store, which one process at a time can have open.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sada_gym.board.benchmark.entries import add_run
from sada_gym.board.benchmark.folder import RunDone, store_file, write_costs
from sada_gym.board.benchmark.job import RunError, RunJob, do_run
from sada_gym.board.benchmark.plan import BenchmarkPlan, RunGroup
from sada_gym.board.benchmark.progress import (
    BenchmarkCallback,
    can_read,
    progress_folder,
    read_progress,
)
from sada_gym.errors import UserError, WorkerError, described
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.workers import WorkerPool
from sada_gym.experiment.algorithm import RunProgress
from sada_gym.experiment.record import RunSettings

_POLL_EVERY_S = 0.25
_DEATHS = 3


@dataclass(eq=False)
class _Chain:
    """A group at work: one run after the other, always in the same place."""

    group: RunGroup
    left: deque[RunSettings]
    place: int

    @property
    def run(self) -> RunSettings:
        return self.left[0]


def do_runs(
    plan: BenchmarkPlan,
    missing: Sequence[RunSettings],
    out: Path,
    entries: Path,
    workers: Workers,
    callback: BenchmarkCallback,
) -> None:
    """Do all missing runs of a plan and add each to its entry; `out` is absolute.

    Raises:
        RunError, StoreError, WorkerError: See `sada_gym.board.benchmark.run.run_benchmark`.
    """
    wanted = {id(run) for run in missing}
    groups = deque(
        (group, runs)
        for group in plan.groups
        if (runs := deque(run for run in group.runs if id(run) in wanted))
    )
    with (
        progress_folder(out) as token,
        closing(_Schedule(plan, groups, workers, out, entries, token, callback)) as schedule,
    ):
        schedule.do()


class _Schedule:
    """Hands out runs and writes down their results.

    Without an executor each place has a process of its own, so that one that dies takes no other
    with it. A user's executor replaces its own workers or gives up.
    """

    def __init__(
        self,
        plan: BenchmarkPlan,
        groups: deque[tuple[RunGroup, deque[RunSettings]]],
        workers: Workers,
        out: Path,
        entries: Path,
        token: str,
        callback: BenchmarkCallback,
    ) -> None:
        self._plan, self._groups, self._executor = plan, groups, workers.executor
        self._out, self._entries = out, entries
        self._token, self._callback = token, callback
        self._places = min(workers.count, len(groups))
        self._each = max(1, workers.count // len(groups)) if workers.executor is None else 1
        self._pools: dict[int, WorkerPool] = {}
        self._active: dict[Future[RunDone], _Chain] = {}
        self._deaths = Counter[str]()
        self._last: dict[str, RunProgress] = {}
        self._visible = self._sees_folder()

    def _sees_folder(self) -> bool:
        if self._executor is None:
            return True
        try:
            return self._executor.submit(can_read, self._out, self._token).result()
        except Exception as error:
            raise _gave_up("a first job", error) from error

    def do(self) -> None:
        """Keep all places busy until nothing is left."""
        for place in range(self._places):
            self._begin_group(place)
        while self._active:
            done, _ = wait(self._active, timeout=_POLL_EVERY_S, return_when="FIRST_COMPLETED")
            self._poll()
            for future in done:
                self._settle(future, self._active.pop(future))

    def close(self) -> None:
        """Drop what is still at work; after the last run that is nothing."""
        for future in self._active:
            future.cancel()
        for pool in self._pools.values():
            # not by a common exit: a process that evaluates in others keeps those for its next
            # run, and would wait for them
            pool.close(now=True)

    def _begin_group(self, place: int) -> None:
        if self._groups:
            self._submit(_Chain(*self._groups.popleft(), place))

    def _submit(self, chain: _Chain) -> None:
        stored, path = None, store_file(self._out, chain.group.target, chain.group.seed)
        if not self._visible:
            self._callback.on_progress(
                chain.run, RunProgress("train", total=chain.run.experiment.protocol.budget)
            )
            if path.exists():
                stored = path.read_bytes()
        job = RunJob(chain.run, chain.group, self._each, self._out, self._token, stored)
        if self._executor is None:
            if chain.place not in self._pools:
                self._pools[chain.place] = WorkerPool(1)
            future = self._pools[chain.place].executor.submit(do_run, job)
        else:
            try:
                future = self._executor.submit(do_run, job)
            except Exception as error:
                raise _gave_up(str(chain.run), error) from error
        self._active[future] = chain

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
            done = future.result()
        except (RunError, UserError, WorkerError):
            raise
        except (Exception, CancelledError) as error:
            if self._executor is not None or not isinstance(error, BrokenExecutor):
                raise _gave_up(str(chain.run), error) from error
            self._pools.pop(chain.place).close(now=True)
            self._count_death(chain.run, error)
        else:
            if done.evaluations:  # of a worker that doesn't see the folder
                path = store_file(self._out, chain.group.target, chain.group.seed)
                path.parent.mkdir(parents=True, exist_ok=True)
                with EvaluationStore(path) as store:
                    context = store.context(chain.group.target.application)
                    for part in done.evaluations:
                        invalid = dict.fromkeys(np.flatnonzero(part.invalid).tolist(), "it broke")
                        store.commit(context, part.mu, part.seed.tolist(), part.score, invalid)
            add_run(self._entries, self._plan.metadata[chain.run.label], done)
            write_costs(self._out, done)
            self._callback.on_finish(chain.left.popleft(), done.timing)
        if chain.left:
            self._submit(chain)
        else:
            self._begin_group(chain.place)

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
        f"The executor gave up on {what} ({described(error)}). What is finished is "
        "kept; run the same command again when its workers are back."
    )
