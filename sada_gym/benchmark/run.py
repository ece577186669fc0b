"""Running a benchmark: its runs as jobs on any executor, resumable at any moment."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from sada_gym.benchmark.folder import claim, find_missing, sole_user
from sada_gym.benchmark.plan import make_plan
from sada_gym.benchmark.progress import BenchmarkCallback
from sada_gym.benchmark.report.pictures import draw_benchmark
from sada_gym.benchmark.report.tables import write_tables
from sada_gym.benchmark.results import Results, write_results
from sada_gym.benchmark.schedule import do_runs
from sada_gym.benchmark.suite import Suite
from sada_gym.errors import refuse_number
from sada_gym.evaluation.workers import MAX_WORKERS
from sada_gym.files import file_errors
from sada_gym.measures.reference import FOLDER


@dataclass(frozen=True)
class BenchmarkResult:
    """The results of a benchmark, and where they are.

    Attributes:
        results: The contents of results.json.
        folder: The benchmark's folder.
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
    executor: Executor | None = None,
    references: str | Path = FOLDER,
    callback: BenchmarkCallback | None = None,
) -> BenchmarkResult:
    """Run a suite: every table, track, agent, contender and seed; then report.

    Killed at any moment and called again with the same arguments, it repeats no finished run and
    no evaluation, and ends with the same results.json. With more tracks, seeds or contenders it
    only adds their runs.

    Args:
        suite: The suite to run.
        out: The benchmark's folder.
        workers: The number of processes. The runs of one track, agent and seed follow one
            another; such groups go side by side. Where there are fewer groups than processes,
            each run evaluates in several. The result does not depend on it.
        executor: Any PEP 3148 executor instead of our own processes (Dask's
            `Client.get_executor()`, threads, loky); `workers` then says how many it has. It is
            left open. Its workers need not see `out`. The result does not depend on it.
        references: The folder of the reference sets.
        callback: Called as the benchmark goes on.

    Raises:
        TypeError, ValueError: If a part of the suite does not fit, or the folder holds another
            benchmark.
        WorkerError: If a run killed its process three times, or the executor gave up.
        RunError: If an adversary raised anything but an `AdversaryError`.
    """
    folder, references = Path(out), Path(references)
    called = callback or BenchmarkCallback()
    refuse_number("workers", workers, 1, MAX_WORKERS)
    plan = make_plan(suite, references)
    with file_errors("make the folder", folder):
        claim(folder, plan)
    with sole_user(folder):
        missing = find_missing(folder, plan)
        called.on_start(plan, missing)
        if missing:
            do_runs(plan, missing, folder.absolute(), workers, executor, called)
        called.on_report()
        return report_benchmark(folder, references, notes=plan.notes)


def report_benchmark(
    out: str | Path, references: str | Path = FOLDER, *, notes: Sequence[str] = ()
) -> BenchmarkResult:
    """Write the results, the tables and the pictures of all runs that a folder holds by now.

    Args:
        out: The benchmark's folder; another process may be at work there.
        references: The folder of the reference sets.
        notes: What a reader must know.

    Raises:
        ValueError: If it is no benchmark's folder, or holds no finished run.
    """
    folder = Path(out)
    results = write_results(folder)
    write_tables(folder, results, notes)
    draw_benchmark(folder, results, Path(references))
    return BenchmarkResult(results, folder, tuple(notes))
