"""The folder of a benchmark: its settings, its lock, and where its runs lie."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from sada_gym.benchmark.plan import Group, Plan
from sada_gym.benchmark.suite import Table
from sada_gym.errors import StoreInUse, UserError
from sada_gym.evaluation.oracle import Evaluations
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
    path, tables, packages = out / SETTINGS_FILE, plan.suite.tables, plan.packages
    known: tuple[Table, ...] = ()
    if path.exists():
        settings = read_model(path, BenchmarkSettings)
        known = settings.tables
        wanted = {table.name: rule(table) for table in tables}
        there = {table.name: rule(table) for table in known if table.name in wanted}
        shared = settings.packages.keys() & packages.keys()
        refuse_other(
            f"the settings that the benchmark in {out} was started with",
            {"packages": {name: settings.packages[name] for name in shared}, **there},
            {
                "packages": {name: packages[name] for name in shared},
                **{name: wanted[name] for name in there},
            },
        )
        packages = in_order({**settings.packages, **packages})
    elif out.exists() and any(not entry.name.startswith(".") for entry in out.iterdir()):
        raise UserError(
            f"Expected a new folder, an empty one or a benchmark's, got {out}, which holds "
            f"something else. Name another."
        )
    out.mkdir(parents=True, exist_ok=True)
    added = [table for table in tables if table.name not in {old.name for old in known}]
    now = BenchmarkSettings(tables=(*known, *added), packages=packages)
    if not path.exists() or now != settings:
        write_model(path, now)


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
    return [(_read_run(folder), folder) for folder in finished_runs(out)]


def finished_runs(out: Path) -> list[Path]:
    """List the folders of all finished runs."""
    return [
        folder
        for folder in sorted((out / RUNS).glob("*/*/*"))
        if not folder.name.startswith(".")
        and any((folder / name).exists() for name in (RESULT_FILE, FAILURE_FILE))
    ]


def _read_run(folder: Path) -> RunReport | RunFailure:
    if (folder / FAILURE_FILE).exists():
        return read_model(folder / FAILURE_FILE, RunFailure)
    return read_model(folder / RESULT_FILE, RunReport)


def write_run(
    out: Path,
    result: RunReport | RunFailure,
    timing: Timing,
    samples: Evaluations | None,
    picture: bytes | None,
) -> None:
    """Put a finished run in place, whole or not at all.

    Args:
        out: The benchmark's folder.
        result: The run's report, or why it failed.
        timing: The time and memory that it took.
        samples: Its test samples; None after a failure.
        picture: The comparison of images as a PNG, if there is one.
    """

    def fill(folder: Path) -> None:
        name = FAILURE_FILE if isinstance(result, RunFailure) else RESULT_FILE
        write_model(folder / name, result)
        if samples is not None:
            write_samples(folder / SAMPLES_FILE, samples)
        if picture is not None:
            write_file(folder / NOVELTY_PICTURE, picture)
        write_model(folder / TIMING_FILE, timing)

    folder = run_folder(out, result.settings)
    folder.parent.mkdir(parents=True, exist_ok=True)
    write_folder(folder, fill)


def rule(table: Table) -> dict[str, object]:
    """Give the part of a table that decides its runs' results."""
    return table.model_dump(mode="json", include={"budget", "budget_of", "samples"})


def _place(track: str, agent: str) -> str:
    return slug(f"{track}.{agent}" if agent else track)


def slug(text: str) -> str:
    """Make a name that any file system takes."""
    return re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-")
