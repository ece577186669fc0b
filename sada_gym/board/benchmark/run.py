"""Running a benchmark: its runs as jobs on any executor, resumable at any moment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym.board.benchmark.entries import Missing, find_missing
from sada_gym.board.benchmark.folder import (
    ENTRIES,
    RunTiming,
    read_costs,
    reserve,
    sole_user,
)
from sada_gym.board.benchmark.pictures import Targets, draw_benchmark
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.results import Results, results_of
from sada_gym.board.benchmark.schedule import do_runs
from sada_gym.board.benchmark.suite import BenchmarkSuite
from sada_gym.board.benchmark.tables import write_tables
from sada_gym.board.results.entry import EntryResult, read_entries
from sada_gym.errors import UserError
from sada_gym.evaluation.executors import Workers
from sada_gym.experiment.record import RunKey, RunSettings
from sada_gym.experiment.target import OpenTarget
from sada_gym.foundations.files import as_path, file_errors
from sada_gym.measures.reference import FOLDER


@dataclass(frozen=True)
class CostEstimate:
    """What the missing runs of a table cost on one track.

    Attributes:
        evaluations: The most evaluations that they ask for, training queries and test samples. Runs
            of one track, agent and seed share some.
        core_hours: The hours of one core that those runs take whose like is known.
        unknown: The number of the other runs.
    """

    table: str
    track: str
    runs: int
    evaluations: int
    core_hours: float
    unknown: int


_LIKE: tuple[Callable[[RunKey], tuple[str, ...]], ...] = (
    lambda run: (run.label, run.table, run.track, run.agent),
    lambda run: (run.label, run.table, run.track),
    lambda run: (run.label, run.track),
)
"""Which runs take about as long as another one; the first that are known count."""


def estimate_costs(runs: Sequence[RunSettings], costs: Iterable[RunTiming]) -> list[CostEstimate]:
    """Estimate what runs cost, table by table and track by track, by what finished runs took."""
    took: dict[tuple[str, ...], list[float]] = {}
    for timing in costs:
        for like in _LIKE:
            took.setdefault(like(timing), []).append(timing.core_s or timing.wall_s)
    by_place: dict[tuple[str, str], list[RunSettings]] = {}
    for run in runs:
        by_place.setdefault((run.key.table, run.key.track), []).append(run)
    estimates = []
    for (table, track), chosen in sorted(by_place.items()):
        keys = [[like(run.key) for like in _LIKE] for run in chosen]
        known = [next((took[key] for key in likes if key in took), None) for likes in keys]
        seconds = [sum(times) / len(times) for times in known if times is not None]
        protocols = [run.experiment.protocol for run in chosen]
        evaluations = sum(protocol.budget + protocol.samples for protocol in protocols)
        estimate = CostEstimate(
            table=table,
            track=track,
            runs=len(chosen),
            evaluations=evaluations,
            core_hours=sum(seconds) / 3600,
            unknown=len(chosen) - len(seconds),
        )
        estimates.append(estimate)
    return estimates


@dataclass(frozen=True)
class BenchmarkResult:
    """The results of a benchmark, where they are, and what a reader must know."""

    results: Results
    folder: Path
    entries: Path
    notes: tuple[str, ...]


def run_benchmark(
    suite: BenchmarkSuite,
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
            folder, references, entries=entries_folder, suite=suite, notes=plan.notes
        )


@dataclass(frozen=True)
class Outlook:
    """What a benchmark would do and cost, and what a reader must know."""

    missing: Missing
    estimates: tuple[CostEstimate, ...]
    notes: tuple[str, ...]


def plan_benchmark(
    suite: BenchmarkSuite,
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
    suite: BenchmarkSuite | None = None,
    notes: Sequence[str] = (),
) -> BenchmarkResult:
    """Write the tables and the pictures of all results that a folder's entries hold by now.

    Another process may be at work there. Without `entries` those in `out` count, and without a
    suite all tracks and the rules by which the results were made. Another folder, or one without a
    result, is a ValueError.
    """
    folder, entries_folder, references = _places(out, entries, references)
    with file_errors("read", entries_folder):
        if not entries_folder.exists():
            raise UserError(
                f"Expected a benchmark's folder, got {folder} without {entries_folder}."
            )
    claimed = [
        entry.keeping(lambda result: suite is None or result.track in suite.tracks)
        for entry in read_entries(entries_folder)
    ]
    attacked = [r.experiment.target for entry in claimed for r in entry.results.values()]
    targets = _open_targets({(target.track, target.agent) for target in attacked}, references)

    def is_current(result: EntryResult) -> bool:
        target = result.experiment.target
        current = targets.get((target.track, target.agent))
        return current is not None and current.target == target

    chosen = [entry.keeping(is_current) for entry in claimed]
    outdated = len(attacked) - sum(len(entry.results) for entry in chosen)
    if outdated:
        what = "One result is" if outdated == 1 else f"{outdated} results are"
        notes = (*notes, f"{what} left out, because the track or its agent has changed since.")
    results = results_of(chosen, suite.tables if suite else ())
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


def _open_targets(keys: Iterable[tuple[str, str]], references: Path) -> Targets:
    """Describe tracks with agents, closed again; those that are no longer there are left out."""
    targets = {}
    for track, agent in sorted(keys):
        # a track or an agent may have been removed, or lie in a module that is not installed here
        with (
            suppress(UserError),
            OpenTarget.of(track, agent=agent, references=references) as target,
        ):
            _ = target.reference  # read while it is open
            targets[track, agent] = target
    return targets
