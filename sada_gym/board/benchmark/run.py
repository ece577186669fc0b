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
        evaluations: The number of their training queries and test samples. Runs of one track, agent
            and seed share some, so fewer worlds may be evaluated.
        core_hours: The time that they take on one core, as similar finished runs took.
        unknown: The number of runs without a similar finished run; `core_hours` leaves them out.
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
    """Estimate the cost of runs for each table and track, from the times of finished runs."""
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
    """The results of a benchmark, the folders of its report and its entries, and remarks."""

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
    """Run every table, track, agent, adversary and seed of a suite; then write the report.

    Each finished run is added to its entry at once. If the call is killed, call it again with the
    same arguments: it repeats no finished run and no evaluation, and ends with the same entries. To
    continue on another machine, copy the entries. If you add tracks, seeds or adversaries, only
    their runs are made. Outdated results are made again.

    Args:
        suite: The suite to run.
        out: The benchmark's folder, for evaluations, costs, tables and pictures.
        entries: The folder of the entries; None takes `out`/entries.
        workers: The number of processes. Groups of runs with the same track, agent and seed run in
            parallel; the runs of a group run one after another. If there are fewer groups than
            processes, each run evaluates in several. With an executor (:class:`~sada_gym.Workers`),
            give its number of workers; they need no access to `out`. Results do not depend on it.
        references: The folder of the reference sets.
        callback: Receives the progress.

    Raises:
        TypeError, ValueError: If a part of the suite is not valid, if the folder holds something
            else, or if a file of an entry cannot be read.
        WorkerError: If a run killed its process three times, or the executor failed.
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
    """What a benchmark would do: `missing.runs` are the runs to make, `estimates` their costs."""

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
    """Return what `run_benchmark` would do and what that costs; nothing is run or written.

    Costs are estimated from the finished runs in `out`. Without `entries`, those in `out` count.
    Raises a TypeError or ValueError if a part of the suite is not valid or cannot be read.
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
    """Write the tables and pictures of all results that the entries hold so far.

    A benchmark may be running there meanwhile. Without `entries`, those in `out` count. Without a
    suite, the report has all tracks and all rules for the budget that occur. Raises a ValueError
    if the folder is not that of a benchmark, or holds no result.
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
