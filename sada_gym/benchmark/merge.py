"""Results of several benchmarks as one: of other applications, seeds or machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sada_gym.benchmark.report.tables import write_tables
from sada_gym.benchmark.results import (
    RESULTS_FILE,
    Results,
    RunSummary,
    Target,
    put_together,
)
from sada_gym.errors import UserError, refuse_unknown
from sada_gym.files import file_errors, read_model, write_model
from sada_gym.runs.record import common, refuse_other


def merge_files(files: Sequence[Path], out: Path, **chosen: Sequence[str]) -> Results:
    """Merge files of results, and write results.json and table.md.

    Args:
        files: Each a results.json, or a folder that holds one.
        out: The folder to write to; it is made.
        chosen: The tables, tracks and contenders to take over, see `merge`.

    Raises:
        ValueError: If a file is none of ours, they do not belong together, or `out` is the folder
            of one of them.
    """
    paths = [_results_file(path) for path in files]
    if out.resolve() in {path.parent.resolve() for path in paths}:
        raise UserError(f"Expected a folder of its own for the report, got {out}, which is merged.")
    parts = [read_model(path, Results) for path in paths]
    merged = merge(parts, **chosen)
    with file_errors("make the folder", out):
        out.mkdir(parents=True, exist_ok=True)
    write_model(out / RESULTS_FILE, merged)
    write_tables(out, merged)
    return merged


def _results_file(path: Path) -> Path:
    with file_errors("read", path):
        return path / RESULTS_FILE if path.is_dir() else path


def merge(
    parts: Sequence[Results],
    *,
    tables: Sequence[str] = (),
    tracks: Sequence[str] = (),
    contenders: Sequence[str] = (),
) -> Results:
    """Put results together as if one benchmark had given them, ranks and all.

    Args:
        parts: At least one.
        tables: Names of the tables to take over; all by default.
        tracks: Ids of the environments to take over; all by default.
        contenders: Labels of the rows to take over; all by default.

    Raises:
        ValueError: If they were made with other packages, rules of a table, or versions of what
            was attacked; if two hold the same run; if none holds a table, a track or a contender
            that is asked for; or if nothing is left.
    """
    if not parts:
        raise UserError("Expected at least one file of results, got none.")
    settings = parts[0].settings
    targets: dict[tuple[str, str], Target] = {}
    runs: dict[tuple[Any, ...], RunSummary] = {}
    for part in parts:
        # an application names only the packages that it loads
        _refuse_unlike("the packages", *common(settings.packages, part.settings.packages))
        rules = common(settings.rules, part.settings.rules)
        for name in rules[0]:
            _refuse_unlike(f"the rule of table {name}", rules[0][name], rules[1][name])
        settings = settings.plus(part.settings)
        for run in part.runs:
            key = (run.table, run.track, run.agent, run.label, run.seed)
            if key in runs:
                raise UserError(f"Expected every run once, got {run} twice. Leave one out.")
            runs[key] = run
        for target in part.targets:
            other = targets.setdefault((target.track, target.agent), target)
            same = target.model_copy(update={"seeds": other.seeds})
            _refuse_unlike(
                f"{target.track} against {target.agent}", other.model_dump(), same.model_dump()
            )
    known = [table.name for table in settings.tables]
    refuse_unknown("table", tables, known)
    refuse_unknown("track", tracks, sorted({run.track for run in runs.values()}))
    refuse_unknown("adversary", contenders, sorted({run.label for run in runs.values()}))
    chosen = [
        run
        for run in runs.values()
        if run.table in (tables or known)
        and (not tracks or run.track in tracks)
        and (not contenders or run.label in contenders)
    ]
    if runs and not chosen:
        raise UserError(
            "Expected runs of these tables, tracks and adversaries, got none in common."
        )
    filled = {run.table for run in chosen}
    kept = tuple(table for table in settings.tables if table.name in filled)
    return put_together(settings.model_copy(update={"tables": kept}), targets, chosen)


def _refuse_unlike(what: str, first: Mapping[str, object], other: Mapping[str, object]) -> None:
    refuse_other(
        f"results of one kind, with {what} alike", first, other, "Merge what was made alike."
    )
