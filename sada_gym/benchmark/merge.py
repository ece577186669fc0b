"""Results of several benchmarks as one: of other applications, seeds or machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sada_gym.benchmark.folder import BenchmarkSettings, rule
from sada_gym.benchmark.report.tables import write_tables
from sada_gym.benchmark.results import (
    FORMAT,
    RESULTS_FILE,
    Results,
    RunSummary,
    Target,
    rows_of_runs,
    run_order,
)
from sada_gym.benchmark.suite import Table
from sada_gym.errors import UserError, refuse_unknown
from sada_gym.files import read_model, write_model
from sada_gym.runs.packages import in_order
from sada_gym.runs.record import refuse_other


def merge_files(files: Sequence[Path], out: Path, *, tables: Sequence[str] = ()) -> Results:
    """Merge files of results, and write results.json and table.md.

    Args:
        files: Each a results.json, or a folder that holds one.
        out: The folder to write to; it is made.
        tables: Names of the tables to take over; all by default.

    Raises:
        ValueError: If a file is none of ours, they do not belong together, or `out` is the folder
            of one of them.
    """
    paths = [path / RESULTS_FILE if path.is_dir() else path for path in files]
    if out.resolve() in {path.parent.resolve() for path in paths}:
        raise UserError(f"Expected a folder of its own for the report, got {out}, which is merged.")
    merged = merge([read_model(path, Results) for path in paths], tables=tables)
    out.mkdir(parents=True, exist_ok=True)
    write_model(out / RESULTS_FILE, merged)
    write_tables(out, merged)
    return merged


def merge(parts: Sequence[Results], *, tables: Sequence[str] = ()) -> Results:
    """Put results together as if one benchmark had given them, ranks and all.

    Args:
        parts: At least one.
        tables: Names of the tables to take over; all by default.

    Raises:
        ValueError: If they were made with other packages, rules of a table, or versions of what
            was attacked; if two hold the same run; or if none holds a table that is asked for.
    """
    if not parts:
        raise UserError("Expected at least one file of results, got none.")
    packages: dict[str, str] = {}
    known: dict[str, Table] = {}
    targets: dict[tuple[str, str], Target] = {}
    runs: dict[tuple[Any, ...], RunSummary] = {}
    for part in parts:
        theirs = part.settings.packages  # an application names only what it loads
        both = packages.keys() & theirs.keys()
        _refuse_unlike(
            "the packages",
            {name: packages[name] for name in both},
            {name: theirs[name] for name in both},
        )
        packages = in_order({**packages, **theirs})
        for table in part.settings.tables:
            first = known.setdefault(table.name, table)
            _refuse_unlike(f"the rule of table {table.name}", rule(first), rule(table))
        for run in part.runs:
            key = (run.table, run.track, run.agent, run.label, run.seed)
            if key in runs:
                raise UserError(f"Expected every run once, got {run} twice. Leave one out.")
            runs[key] = run
        for target in part.targets:
            place = (target.track, target.agent)
            other = targets.get(place, target)
            same = target.model_copy(update={"seeds": other.seeds})
            _refuse_unlike(
                f"{target.track} against {target.agent}", other.model_dump(), same.model_dump()
            )
            seeds = tuple(sorted({*other.seeds, *target.seeds}))
            targets[place] = target.model_copy(update={"seeds": seeds})
    refuse_unknown("table", tables, list(known))
    names = [name for name in known if not tables or name in tables]
    chosen = sorted(
        (run for run in runs.values() if run.table in names),
        key=lambda run: run_order(run, list(known)),
    )
    attacked = dict.fromkeys((run.track, run.agent) for run in chosen)
    return Results(
        format=FORMAT,
        settings=BenchmarkSettings(tables=tuple(known[name] for name in names), packages=packages),
        targets=tuple(targets[place] for place in attacked),
        rows=tuple(rows_of_runs(chosen)),
        runs=tuple(chosen),
    )


def _refuse_unlike(what: str, first: Mapping[str, object], other: Mapping[str, object]) -> None:
    refuse_other(
        f"results of one kind, with {what} alike", first, other, "Merge what was made alike."
    )
