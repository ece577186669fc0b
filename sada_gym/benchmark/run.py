"""Running a benchmark: its groups in parallel processes, resumable at any moment."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future, wait
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Protocol

from sada_gym.benchmark.cell import Told
from sada_gym.benchmark.folder import claim, find_missing, sole_user
from sada_gym.benchmark.pictures import draw_pictures
from sada_gym.benchmark.plan import CellSettings, Plan, make_plan
from sada_gym.benchmark.results import Results, write_results
from sada_gym.benchmark.suite import Suite
from sada_gym.benchmark.tables import write_tables
from sada_gym.benchmark.work import Job, connect, work
from sada_gym.errors import WorkerError, refuse_number
from sada_gym.evaluation.spawn import spawn_context
from sada_gym.evaluation.workers import MAX_WORKERS, WorkerPool
from sada_gym.files import file_errors
from sada_gym.measures.reference import FOLDER

_LISTEN_EVERY_S = 0.1


class Listener(Protocol):
    """What hears of a benchmark's progress."""

    def begin(self, plan: Plan, missing: Sequence[CellSettings]) -> None:
        """Hear what there is to do."""

    def hear(self, told: Told) -> None:
        """Hear what a process is at."""

    def finish(self) -> None:
        """Hear that all cells are there, and that the report is being written."""


@dataclass(frozen=True)
class BenchmarkResult:
    """What a benchmark gave.

    Attributes:
        results: The contents of results.json.
        folder: Where all of it is.
        notes: What a reader must know, such as an adversary that was left out.
    """

    results: Results
    folder: Path
    notes: tuple[str, ...]


def run_benchmark(
    suite: Suite,
    out: str | Path,
    *,
    workers: int = 1,
    references: str | Path = FOLDER,
    listener: Listener | None = None,
) -> BenchmarkResult:
    """Run a suite: every table, track, agent, contender and seed; then report.

    Killed at any moment and called again with the same arguments, it repeats no finished cell and
    no evaluation, and ends with the same results.json. With more tracks, seeds or contenders it
    only adds their cells.

    Args:
        suite: What to run.
        out: Its folder.
        workers: Processes. Groups of cells run side by side, each in one process; where there are
            fewer groups than that, each evaluates in several. No part of the result.
        references: Where the reference sets lie.
        listener: Hears of the progress.

    Raises:
        TypeError, ValueError: If something of the suite is bad, or the folder holds another
            benchmark.
        WorkerError: If a process died.
        CellError: If an adversary raised anything but a ValueError.
    """
    folder, references, heard = Path(out), Path(references), listener or _Deaf()
    refuse_number("workers", workers, 1, MAX_WORKERS)
    plan = make_plan(suite, references)
    with file_errors("make the folder", folder):
        claim(folder, suite.tables)
    with sole_user(folder):
        missing = find_missing(folder, plan)
        heard.begin(plan, missing)
        if missing:
            _run(plan, missing, folder, references, workers, heard)
        heard.finish()
        return report_benchmark(folder, references, notes=plan.notes)


def report_benchmark(
    out: str | Path, references: str | Path = FOLDER, *, notes: Sequence[str] = ()
) -> BenchmarkResult:
    """Write the results, the tables and the pictures of all cells that a folder holds by now.

    Args:
        out: The benchmark's folder; another process may be at work there.
        references: Where the reference sets lie.
        notes: What a reader must know.

    Raises:
        ValueError: If it is no benchmark's folder, or holds no finished cell.
    """
    folder = Path(out)
    results = write_results(folder)
    write_tables(folder, results, notes)
    draw_pictures(folder, results, Path(references))
    return BenchmarkResult(results, folder, tuple(notes))


def _run(
    plan: Plan,
    missing: Sequence[CellSettings],
    out: Path,
    references: Path,
    workers: int,
    listener: Listener,
) -> None:
    """Make what is missing."""
    wanted = {id(cell) for cell in missing}
    groups = [
        replace(group, cells=cells)
        for group in plan.groups
        if (cells := tuple(cell for cell in group.cells if id(cell) in wanted))
    ]
    each = max(1, workers // len(groups))
    jobs = [Job(group, out, references, each) for group in groups]
    channel: SimpleQueue[Told] = spawn_context().SimpleQueue()
    pool = WorkerPool(min(workers, len(groups)), prepare=partial(connect, channel))
    now = True
    try:
        futures = {pool.executor.submit(work, job): job for job in jobs}
        _listen(futures, channel, listener)
        now = False
    finally:
        pool.close(now=now)


def _listen(
    futures: dict[Future[None], Job], channel: SimpleQueue[Told], listener: Listener
) -> None:
    """Pass on what the processes tell until all groups are done, or one failed."""
    pending, at = set(futures), dict[tuple[str, str, int], str]()
    while pending:
        done, pending = wait(pending, timeout=_LISTEN_EVERY_S)
        while not channel.empty():
            told = channel.get()
            place = (told.cell.track, told.cell.agent, told.cell.seed)
            at[place] = "between two cells" if told.stage == "finished" else str(told.cell)
            listener.hear(told)
        for future in done:
            try:
                future.result()
            except BrokenExecutor as error:
                doing = "; ".join(sorted(set(at.values()))) or "their start"
                raise WorkerError(
                    "A process of the benchmark died: out of memory, or killed. They were at: "
                    f"{doing}. What is finished is kept; run the same command again, with fewer "
                    "workers if memory was short."
                ) from error


class _Deaf:
    """A listener that does not listen."""

    def begin(self, plan: Plan, missing: Sequence[CellSettings]) -> None: ...

    def hear(self, told: Told) -> None: ...

    def finish(self) -> None: ...
