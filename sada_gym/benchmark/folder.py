"""The folder of a benchmark: its settings, its lock, and where its runs lie."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from typing_extensions import Self

from sada_gym.benchmark.plan import Group, Plan
from sada_gym.benchmark.suite import Table
from sada_gym.errors import StoreInUse, UserError
from sada_gym.evaluation.oracle import Evaluations
from sada_gym.evaluation.store import Context
from sada_gym.evaluation.store_errors import explained, in_use, refuse_unusable
from sada_gym.files import Strict, read_model, write_file, write_folder, write_model
from sada_gym.runs.packages import in_order
from sada_gym.runs.record import (
    RESULT_FILE,
    SAMPLES_FILE,
    RunFailure,
    RunKey,
    RunReport,
    RunSettings,
    common,
    refuse_other,
    write_samples,
)

SETTINGS_FILE = "benchmark.json"
FAILURE_FILE = "failure.json"
TIMING_FILE = "timing.json"
NOVELTY_PICTURE = "novelty.png"
RUNS, STORES = "runs", "stores"


class BenchmarkSettings(Strict):
    """What all runs of a folder have in common: benchmark.json.

    Attributes:
        tables: The comparisons. The agents that they attack may differ between calls.
        packages: The versions of the packages that take part in any run.
    """

    tables: tuple[Table, ...]
    packages: dict[str, str]

    @property
    def rules(self) -> dict[str, dict[str, object]]:
        """Give the part of each table that decides its runs' results, by name."""
        parts = {"budget", "budget_of", "samples"}
        return {table.name: table.model_dump(mode="json", include=parts) for table in self.tables}

    def plus(self, other: Self) -> Self:
        """Add the tables and packages that only the other settings have."""
        added = [table for table in other.tables if table.name not in self.rules]
        packages = in_order({**self.packages, **other.packages})
        return self.model_copy(update={"tables": (*self.tables, *added), "packages": packages})


class Timing(Strict):
    """What a run cost when it was made: timing.json beside its result.

    Attributes:
        training_s: The process seconds of the adversary itself, training and sampling.
        evaluation_s: The process seconds of evaluations, without other worker processes.
        evaluated: The number of evaluations made.
        known: The number of evaluations that the store knew from other runs or earlier calls.
        wall_s: All seconds, measuring included.
        peak_memory_mib: The process's peak memory; None where the system does not measure it.
    """

    training_s: float
    evaluation_s: float
    evaluated: int
    known: int
    wall_s: float
    peak_memory_mib: int | None


@dataclass(frozen=True, eq=False)
class RunDone:
    """A finished run as a worker gives it back.

    Attributes:
        result: The run's report, or why it failed.
        timing: The time and memory that it took.
        samples: Its test samples; None after a failure.
        picture: The comparison of images as a PNG, if there is one.
        context: What its scores belong to.
        evaluations: The evaluations that the group's store still lacks; none where the worker had
            it open.
    """

    result: RunReport | RunFailure
    timing: Timing
    samples: Evaluations | None
    picture: bytes | None
    context: Context
    evaluations: tuple[Evaluations, ...]


def run_folder(out: Path, run: RunKey) -> Path:
    """Give the folder of a run."""
    place = _place(run.track, run.agent)
    return out / RUNS / slug(run.table) / place / f"{slug(run.label)}-{run.seed}"


def store_file(out: Path, group: Group | RunKey) -> Path:
    """Give the evaluation store that the runs of a group share."""
    return out / STORES / f"{_place(group.track, group.agent)}.{group.seed}.sqlite"


def claim(out: Path, plan: Plan) -> None:
    """Make a folder a benchmark's own, or find that it is one with the same settings.

    Raises:
        ValueError: If it is a file, holds something else, or a benchmark with other settings.
            Nothing is changed then.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"Expected a folder for the results, got the file {out}. Name another.")
    path = out / SETTINGS_FILE
    settings = BenchmarkSettings(tables=plan.suite.tables, packages=plan.packages)
    known = None
    if path.exists():
        known = read_model(path, BenchmarkSettings)
        old, new = common(known.packages, settings.packages)
        old_rules, new_rules = common(known.rules, settings.rules)
        refuse_other(
            f"the settings that the benchmark in {out} was started with",
            {"packages": old, **old_rules},
            {"packages": new, **new_rules},
        )
        settings = known.plus(settings)
    elif out.exists() and any(not entry.name.startswith(".") for entry in out.iterdir()):
        raise UserError(
            f"Expected a new folder, an empty one or a benchmark's, got {out}, which holds "
            f"something else. Name another."
        )
    out.mkdir(parents=True, exist_ok=True)
    if settings != known:
        write_model(path, settings)


@contextmanager
def sole_user(out: Path) -> Iterator[None]:
    """Keep other benchmarks out of a folder; the system ends that even when this one is killed.

    Raises:
        StoreInUse: If another benchmark is at work there.
        StoreError: If the folder cannot be locked.
    """
    path = out / ".lock"
    refuse_unusable(path)
    with ExitStack() as stack:
        with explained(path):
            lock = stack.enter_context(
                closing(sqlite3.connect(path, timeout=0, isolation_level=None))
            )
            try:
                lock.execute("BEGIN EXCLUSIVE")
            except sqlite3.OperationalError as error:
                if not in_use(error):
                    raise
                raise StoreInUse(
                    f"Expected to be the only benchmark in {out}, but another is at work there. "
                    "Wait for it to end, or name another folder."
                ) from error
        yield


def find_missing(out: Path, plan: Plan) -> list[RunSettings]:
    """List the runs of a plan that are yet to be made.

    Raises:
        ValueError: If a run is there with other settings than the plan's, or one that the plan
            does not name is of another version of a track, its agent or its reference set.
    """
    there = {folder: result.settings for result, folder in read_runs(out)}
    missing, targets = [], dict[tuple[str, str], RunSettings]()
    for run in plan.runs:
        targets[run.track, run.agent] = run
        found = there.pop(run_folder(out, run), None)
        if found is None:
            missing.append(run)
        else:
            _refuse_other_run(out, run, found.model_dump(), run.model_dump())
    for found in there.values():
        like = targets.get((found.track, found.agent), found)
        _refuse_other_run(out, found, found.target(), like.target())
    return missing


def _refuse_other_run(
    out: Path, run: RunSettings, old: dict[str, object], new: dict[str, object]
) -> None:
    refuse_other(
        f"{run_folder(out, run)} to be a run of the settings that are asked for",
        old,
        new,
        "Name another folder, or delete that run and its like: they are made anew, and "
        f"{out / STORES} keeps their evaluations.",
    )


def read_runs(out: Path) -> list[tuple[RunReport | RunFailure, Path]]:
    """Read all finished runs, those of earlier calls too, each with its folder."""
    runs: list[tuple[RunReport | RunFailure, Path]] = []
    for folder in finished_runs(out):
        if (folder / FAILURE_FILE).exists():
            runs.append((read_model(folder / FAILURE_FILE, RunFailure), folder))
        else:
            runs.append((read_model(folder / RESULT_FILE, RunReport), folder))
    return runs


def finished_runs(out: Path) -> list[Path]:
    """List the folders of all finished runs."""
    files = (out / RUNS).glob("*/*/*/*.json")
    folders = {file.parent for file in files if file.name in (RESULT_FILE, FAILURE_FILE)}
    return sorted(folder for folder in folders if not folder.name.startswith("."))


def write_run(out: Path, done: RunDone) -> None:
    """Put a finished run in place, whole or not at all."""

    def fill(folder: Path) -> None:
        failed = isinstance(done.result, RunFailure)
        write_model(folder / (FAILURE_FILE if failed else RESULT_FILE), done.result)
        if done.samples is not None:
            write_samples(folder / SAMPLES_FILE, done.samples)
        if done.picture is not None:
            write_file(folder / NOVELTY_PICTURE, done.picture)
        write_model(folder / TIMING_FILE, done.timing)

    folder = run_folder(out, done.result.settings)
    folder.parent.mkdir(parents=True, exist_ok=True)
    write_folder(folder, fill)


def _place(track: str, agent: str) -> str:
    return slug(f"{track}.{agent}" if agent else track)


def slug(text: str) -> str:
    """Make a name that any file system takes."""
    return re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-")
