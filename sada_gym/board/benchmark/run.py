"""Running a benchmark: its runs as jobs on any executor, resumable at any moment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym.board.benchmark.costs import CostEstimate, estimate_costs
from sada_gym.board.benchmark.entries import Missing, find_missing
from sada_gym.board.benchmark.folder import ENTRIES, read_costs, reserve, sole_user
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.report.pictures import draw_benchmark
from sada_gym.board.benchmark.report.tables import write_tables
from sada_gym.board.benchmark.results import Results, results_of
from sada_gym.board.benchmark.schedule import do_runs
from sada_gym.board.benchmark.suite import Suite, Table
from sada_gym.board.benchmark.targets import current_targets, without_outdated
from sada_gym.board.results.entry import read_entries
from sada_gym.errors import UserError
from sada_gym.evaluation.executors import Workers
from sada_gym.foundations.files import as_path, file_errors
from sada_gym.measures.reference import FOLDER


@dataclass(frozen=True)
class BenchmarkResult:
    """The results of a benchmark, where they are, and what a reader must know."""

    results: Results
    folder: Path
    entries: Path
    notes: tuple[str, ...]


def run_benchmark(
    suite: Suite,
    out: str | Path,
    *,
    entries: str | Path | None = None,
    workers: int | Workers = 1,
    references: str | Path = FOLDER,
    callback: BenchmarkCallback | None = None,
) -> BenchmarkResult:
    """Run a suite: every table, track, agent, adversary and seed; then report.

    Each finished run is added to its entry at once. Killed at any moment and called again with the
    same arguments, it repeats no finished run and no evaluation, and ends with the same entries.
    Another machine needs only the entries to go on. With more tracks, seeds or adversaries it only
    adds their runs. Outdated results are repeated.

    Args:
        suite: The suite to run.
        out: The benchmark's folder, for evaluations, costs, tables and pictures.
        entries: The folder of the entries; None takes `out`/entries.
        workers: The number of processes. The runs of one track, agent and seed follow one
            another; such groups go side by side. Where there are fewer groups than processes,
            each run evaluates in several. Of an executor, see `Workers`, it is how many workers
            that has, which need not see `out`. The result does not depend on it.
        references: The folder of the reference sets.
        callback: Called as the benchmark goes on.

    Raises:
        TypeError, ValueError: If a part of the suite does not fit, the folder holds something
            else, or a file of an entry cannot be read.
        WorkerError: If a run killed its process three times, or the executor gave up.
        RunError: If an adversary raised anything but an `AdversaryError`.
    """
    folder, entries_folder, references = _places(out, entries, references)
    called = callback or BenchmarkCallback()
    who = Workers.of(workers)
    plan = make_plan(suite, references)
    with file_errors("make the folder", folder):
        reserve(folder)
    with file_errors("make the folder", entries_folder):
        entries_folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        for place in dict.fromkeys((folder.resolve(), entries_folder.resolve())):
            stack.enter_context(sole_user(place))
        missing = find_missing(entries_folder, plan)
        called.on_start(plan, missing)
        if missing.runs:
            out, entries = folder.absolute(), entries_folder.absolute()
            do_runs(plan, missing.runs, out, entries, who, called)
        called.on_report()
        return report_benchmark(
            folder,
            references,
            entries=entries_folder,
            tables=suite.tables,
            tracks=suite.tracks,
            notes=plan.notes,
        )


@dataclass(frozen=True)
class Outlook:
    """What a benchmark would do and cost, and what a reader must know."""

    missing: Missing
    estimates: tuple[CostEstimate, ...]
    notes: tuple[str, ...]


def plan_benchmark(
    suite: Suite,
    out: str | Path,
    *,
    entries: str | Path | None = None,
    references: str | Path = FOLDER,
) -> Outlook:
    """Say what `run_benchmark` would do and what that costs; nothing is run or written.

    The costs follow from the finished runs in `out`; without `entries` those of `out` count. What
    does not fit, or cannot be read, is a TypeError or ValueError.
    """
    folder, entries_folder, references = _places(out, entries, references)
    plan = make_plan(suite, references)
    missing = find_missing(entries_folder, plan)
    return Outlook(missing, tuple(estimate_costs(missing.runs, read_costs(folder))), plan.notes)


def report_benchmark(
    out: str | Path,
    references: str | Path = FOLDER,
    *,
    entries: str | Path | None = None,
    tables: Sequence[Table] | None = None,
    tracks: Collection[str] | None = None,
    notes: Sequence[str] = (),
) -> BenchmarkResult:
    """Write the tables and the pictures of all results that a folder's entries hold by now.

    Another process may be at work there. Without `entries` those in `out` count, without `tables`
    those of the rules by which the results were made, and without `tracks` all of them. Another
    folder, or one without a result, is a ValueError.
    """
    folder, entries_folder, references = _places(out, entries, references)
    with file_errors("read", entries_folder):
        if not entries_folder.exists():
            raise UserError(
                f"Expected a benchmark's folder, got {folder} without {entries_folder}."
            )
    chosen = [
        entry.keeping(lambda result: tracks is None or result.track in tracks)
        for entry in read_entries(entries_folder)
    ]
    attacked_targets = (r.claimed.experiment.target for e in chosen for r in e.results.values())
    attacked = {(target.track, target.agent) for target in attacked_targets}
    targets = current_targets(attacked, references)
    chosen, outdated = without_outdated(chosen, targets)
    if outdated:
        what = "One result is" if outdated == 1 else f"{outdated} results are"
        notes = (*notes, f"{what} left out, because the track or its agent has changed since.")
    results = results_of(chosen, tables or ())
    if not results.runs:
        raise UserError(
            f"Expected finished runs in {entries_folder}, got none yet. Run the benchmark."
        )
    with file_errors("make the folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_tables(folder, results, notes)
    draw_benchmark(folder, results, chosen, targets)
    return BenchmarkResult(results, folder, entries_folder, tuple(notes))


def _places(out: Any, entries: Any, references: Any) -> tuple[Path, Path, Path]:
    folder = as_path(out, "the folder for the results")
    kept = folder / ENTRIES if entries is None else as_path(entries, "the entries")
    return folder, kept, as_path(references, "the reference sets")
