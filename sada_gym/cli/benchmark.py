"""`sada-gym benchmark`: many adversaries on many tracks under equal conditions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.markup import escape

from sada_gym.board.benchmark.suite import SUITES, choose, find_suite
from sada_gym.board.results.columns import row_cells, row_columns
from sada_gym.board.results.sheet import Line, Sheet
from sada_gym.cli.console import (
    check_no_stray_words,
    cores,
    err,
    errors_as_sentences,
    executor_option,
    json_option,
    make_table,
    option,
    out,
    print_json,
    say,
    show_resume_hint,
    stop_code,
    stoppable,
    workers_option,
)
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from sada_gym.board.benchmark.run import BenchmarkResult, CostEstimate, Outlook


SUITES_HELP = f"What to run: {', '.join(suite.name for suite in SUITES)}."


def benchmark(
    context: typer.Context,
    suite: str = option("quick", SUITES_HELP, metavar="NAME"),
    tracks: list[str] | None = option(
        None, "An environment; repeatable.", "--track", metavar="ID", shown="the suite's own"
    ),
    tables: list[str] | None = option(
        None, "A table of the suite; repeatable.", "--table", metavar="NAME", shown="all"
    ),
    agents: list[str] | None = option(
        None, "An agent; repeatable.", "--agent", metavar="NAME", shown="the tables' own"
    ),
    adversaries: list[str] | None = option(
        None,
        "A name, `name:preset`, `module:Class` or `ideal`; repeatable.",
        *("--adversary", "-a"),
        metavar="NAME",
        shown="the suite's own",
    ),
    seeds: int | None = option(None, "Seeds on every track.", minimum=1, shown="the suite's own"),
    budget: int | None = option(None, "Training queries.", minimum=1, shown="the tables' own"),
    samples: int | None = option(None, "Test samples.", minimum=1, shown="the environments' own"),
    images: int | None = option(
        None,
        "For how many samples of the first seed to compare the nearest queries as images.",
        minimum=0,
        shown="the suite's own",
    ),
    workers: int | None = workers_option(None, "the cores"),
    executor: str = executor_option(),
    out_folder: Path | None = option(
        None,
        "The folder for evaluations, costs, tables and pictures.",
        "--out",
        metavar="DIR",
        shown="runs/benchmark-SUITE",
    ),
    entries: Path | None = option(
        None, "The folder for results as leaderboard entries.", metavar="DIR", shown="DIR/entries"
    ),
    references: Path | None = option(
        None, "The folder of the reference sets.", metavar="DIR", shown="the shipped ones"
    ),
    report: bool = option(
        False,
        "Run nothing; report what DIR holds so far; with --suite, only that suite.",
        "--report",
    ),
    plan: bool = option(False, "Run nothing; list missing runs and their cost.", "--plan"),
    as_json: bool = json_option(),
) -> None:
    """Compare adversaries: every table, track, agent, adversary and seed.

    Call it again with the same DIR after a stop, or with more tracks, seeds or adversaries: it
    repeats only outdated runs. DIR receives entries/ with the results, table.md and pictures/ for
    readers, stores/ with all evaluations, and timings.jsonl. Another machine needs only the entries
    to continue.
    """
    folder = out_folder or Path("runs") / f"benchmark-{suite}"
    with errors_as_sentences():
        check_no_stray_words(context.args, "--track A --track B")
        if plan and report:
            raise UserError("Expected --plan or --report, got both. Leave one out.")
        from sada_gym.board.benchmark.run import plan_benchmark, report_benchmark, run_benchmark
        from sada_gym.cli.benchmark_progress import BenchmarkProgress
        from sada_gym.evaluation.executors import open_executor
        from sada_gym.measures.reference import FOLDER

        known = references or FOLDER
        source = context.get_parameter_source("suite")
        chosen = None
        if not report or source is None or source.name != "DEFAULT":
            chosen = choose(
                find_suite(suite),
                tracks=tracks or (),
                tables=tables or (),
                chosen=adversaries or (),
                agents=agents or (),
                seeds=seeds,
                budget=budget,
                samples=samples,
                images=images,
            )
        if report or chosen is None:
            result = report_benchmark(folder, known, entries=entries, suite=chosen)
        elif plan:
            outlook = plan_benchmark(chosen, folder, entries=entries, references=known)
            _show_outlook(outlook, as_json)
            return
        else:
            # what a stopped process leaves is cleaned up, which is no news to the user
            sys.warnoptions.append("ignore:resource_tracker:UserWarning")
            progress = BenchmarkProgress(err if as_json else out)
            where: dict[str, Any] = {"entries": entries, "references": known, "callback": progress}
            try:
                with stoppable(), open_executor(executor, workers or cores()) as opened, progress:
                    result = run_benchmark(chosen, folder, workers=opened.workers, **where)
            except KeyboardInterrupt as stop:
                runs = f"{progress.finished:,} finished runs"
                show_resume_hint(
                    f"{runs} and all evaluations are saved in {folder}."
                    if entries is None
                    else f"{runs} are saved in {entries}, and all evaluations in {folder}."
                )
                raise typer.Exit(stop_code(stop)) from None
    _show_result(result, as_json)


def _show_outlook(outlook: Outlook, as_json: bool) -> None:
    if as_json:
        runs = [run.key for run in outlook.missing.runs]
        print_json({"missing": runs, "estimates": outlook.estimates, "notes": outlook.notes})
        return
    from sada_gym.cli.benchmark_progress import describe_missing

    say(describe_missing(outlook.missing))
    costs = outlook.estimates
    table = make_table("table", "track", "runs", "evaluations", "core hours", left=2)
    for cost in costs:
        counts = f"{cost.runs:,}", f"{cost.evaluations:,}"
        table.add_row(escape(cost.table), escape(cost.track), *counts, _hours(cost))
    if costs:
        out.print(table)
        unknown = sum(cost.unknown for cost in costs)
        if unknown == sum(cost.runs for cost in costs):
            say("No run like these was timed yet, so the core hours are unknown.")
        else:
            rest = f", without {unknown:,} runs of kinds that were never timed" if unknown else ""
            say(f"About {sum(cost.core_hours for cost in costs):.1f} core hours{rest}.")
    for note in outlook.notes:
        say(note, lead="[yellow]Warning:[/] ")


def _hours(cost: CostEstimate) -> str:
    if cost.unknown == cost.runs:
        return "unknown"
    return f"{cost.core_hours:.2f}" + (f" + {cost.unknown:,} unknown" if cost.unknown else "")


_KEYS = ("adversary", "f1", "rank", "afr", "relative_coverage", "runs")


def _show_result(result: BenchmarkResult, as_json: bool) -> None:
    sheets = {
        " · ".join(comparison.names): Sheet(
            name="",
            title="",
            columns=row_columns(*_KEYS),
            lines=tuple(Line("ranked", row_cells(row, _KEYS)) for row in comparison.rows),
        )
        for comparison in result.results.comparisons
    }
    if as_json:
        tables = [{"table": title, "rows": [*sheet.records()]} for title, sheet in sheets.items()]
        places = {"folder": result.folder, "entries": result.entries}
        print_json({"tables": tables, "notes": result.notes, **places})
        return
    for title, sheet in sheets.items():
        table = make_table(*(column.title for column in sheet.columns), title=title, left=1)
        for line in sheet.lines:
            table.add_row(*(escape(line.cells[key].text) for key in _KEYS))
        out.print(table)
    for note in result.notes:
        say(note, lead="[yellow]Warning:[/] ")
    say(f"Results: {result.entries}/; to read: {result.folder}/ (table.md, pictures/)")
