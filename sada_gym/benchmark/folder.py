"""The folder of a benchmark: whose it is, where its cells lie, and what they hold."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from sada_gym.benchmark.measure import Measures, Search
from sada_gym.benchmark.plan import CellKey, CellSettings, Group, Plan
from sada_gym.benchmark.suite import Table
from sada_gym.errors import UserError
from sada_gym.files import Strict, read_model, write_model
from sada_gym.runs.record import packages

SETTINGS_FILE = "benchmark.json"
CELL_FILE = "cell.json"
TIMING_FILE = "timing.json"
CELLS, STORES = "cells", "stores"


class BenchmarkSettings(Strict):
    """What all cells of a folder have in common: benchmark.json.

    Attributes:
        tables: The comparisons; which agents they attack is no part of this.
        packages: Versions of what takes part.
    """

    tables: tuple[Table, ...]
    packages: dict[str, str]


class CellReport(Strict):
    """The contents of cell.json. No wall-clock times: a resumed run's file is the same.

    Attributes:
        settings: What was run.
        fooling_threshold: The agent is fooled where Q <= this.
        error: Why there is no result: what the adversary's ValueError said.
        measures: What its test samples tell; None after an error.
        search: What its training queries found; None after an error.
        flags: What it says of its training, such as that no point fooled.
    """

    settings: CellSettings
    fooling_threshold: float
    error: str | None
    measures: Measures | None
    search: Search | None
    flags: tuple[str, ...]


class Timing(Strict):
    """What a cell cost when it was made: timing.json beside cell.json.

    Attributes:
        training_s: Process seconds of the adversary itself, training and sampling.
        evaluation_s: Process seconds of evaluations; those of further worker processes don't count.
        evaluated: Evaluations made.
        known: Evaluations that the store knew: of other cells, or of a call that was stopped.
        wall_s: Seconds in all, measuring included.
        peak_memory_mib: The process's peak memory; None where the system does not tell.
    """

    training_s: float
    evaluation_s: float
    evaluated: int
    known: int
    wall_s: float
    peak_memory_mib: int | None


def cell_folder(out: Path, cell: CellKey) -> Path:
    """Where a cell lies."""
    place = _place(cell.track, cell.agent)
    return out / CELLS / slug(cell.table) / place / f"{slug(cell.label)}-{cell.seed}"


def store_file(out: Path, group: Group) -> Path:
    """Where a group's evaluation store lies."""
    return out / STORES / f"{_place(group.track, group.agent)}.{group.seed}.sqlite"


def claim(out: Path, tables: Sequence[Table]) -> None:
    """Make a folder a benchmark's own, or find that it is one with the same settings.

    Raises:
        ValueError: If it is a file, holds something else, or a benchmark with other settings.
            Nothing is changed then.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"Expected a folder for the results, got the file {out}. Name another.")
    path, now = out / SETTINGS_FILE, packages()
    known: tuple[Table, ...] = ()
    if path.exists():
        settings = read_model(path, BenchmarkSettings)
        known = settings.tables
        changes = differences({"packages": settings.packages}, {"packages": now})
        for old in known:
            for new in tables:
                if old.name == new.name:
                    changes += [f"{old.name}: {c}" for c in differences(rule(old), rule(new))]
        if changes:
            raise UserError(
                f"Expected the settings that the benchmark in {out} was started with, got others: "
                f"{'; '.join(changes)}. Give the same ones, or name another folder."
            )
    elif out.exists() and any(not entry.name.startswith(".") for entry in out.iterdir()):
        raise UserError(
            f"Expected a new folder, an empty one or a benchmark's, got {out}, which holds "
            f"something else. Name another."
        )
    out.mkdir(parents=True, exist_ok=True)
    added = [table for table in tables if table.name not in {old.name for old in known}]
    if added or not path.exists():
        write_model(path, BenchmarkSettings(tables=(*known, *added), packages=now))


@contextmanager
def sole_user(out: Path) -> Iterator[None]:
    """Keep other benchmarks out of a folder; the system ends that even when this one is killed.

    Raises:
        ValueError: If another benchmark is at work there.
    """
    with closing(sqlite3.connect(out / ".lock", timeout=0.0, isolation_level=None)) as lock:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            raise UserError(
                f"Expected to be the only benchmark in {out}, but another is at work there. Wait "
                "for it to end, or name another folder."
            ) from error
        yield


def find_missing(out: Path, plan: Plan) -> list[CellSettings]:
    """The cells of a plan that are yet to be made.

    Raises:
        ValueError: If a cell is there with other settings than the plan's, or one that the plan
            does not name is of another version of a track, its agent or its reference set.
    """
    there = {folder: report.settings for report, folder in read_cells(out)}
    missing, targets = [], dict[tuple[str, str], CellSettings]()
    for cell in plan.cells:
        targets[cell.track, cell.agent] = cell
        found = there.pop(cell_folder(out, cell), None)
        if found is None:
            missing.append(cell)
        else:
            _refuse_other(out, found, cell, CellSettings.model_dump)
    for found in there.values():
        cell = targets.get((found.track, found.agent), found)
        _refuse_other(out, found, cell, CellSettings.target)
    return missing


def read_cells(out: Path) -> list[tuple[CellReport, Path]]:
    """All finished cells, of earlier calls too, each with its folder."""
    folders = [path.parent for path in sorted((out / CELLS).glob(f"*/*/*/{CELL_FILE}"))]
    whole = [folder for folder in folders if not folder.name.startswith(".")]
    return [(read_model(folder / CELL_FILE, CellReport), folder) for folder in whole]


def _refuse_other(
    out: Path,
    old: CellSettings,
    new: CellSettings,
    view: Callable[[CellSettings], dict[str, object]],
) -> None:
    changes = differences(view(old), view(new))
    if changes:
        raise UserError(
            f"Expected {cell_folder(out, old)} to be a cell of the settings that are asked for, "
            f"got others: {'; '.join(changes)}. Name another folder, or delete that cell and its "
            f"like: they are made anew, and {out / STORES} keeps their evaluations."
        )


def rule(table: Table) -> dict[str, object]:
    """What of a table decides its cells' results."""
    return table.model_dump(mode="json", include={"budget", "budget_of", "samples"})


def differences(old: Mapping[str, object], new: Mapping[str, object]) -> list[str]:
    """Name what differs between two records, down to single entries."""
    found = []
    for name in sorted({*old, *new}):
        before, now = old.get(name), new.get(name)
        if isinstance(before, Mapping) and isinstance(now, Mapping):
            found += [f"{name}.{change}" for change in differences(before, now)]
        elif before != now:
            found.append(f"{name} was {before!r} and is {now!r}")
    return found


def _place(track: str, agent: str) -> str:
    return slug(f"{track}.{agent}" if agent else track)


def slug(text: str) -> str:
    """Make a name that any file system takes."""
    return re.sub(r"[^A-Za-z0-9._+]+", "-", text).strip("-")
