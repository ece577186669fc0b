"""`sada-gym benchmark`: many adversaries on many tracks under equal conditions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from sada_gym.benchmark.suite import SUITES, choose, find_suite
from sada_gym.cli.console import (
    WORKERS_HELP,
    ExecutorName,
    cores,
    errors_as_sentences,
    make_table,
    option,
    out,
    refuse_stray,
    say,
    show_resume_hint,
)
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from sada_gym.benchmark.costs import Estimate
    from sada_gym.benchmark.run import BenchmarkResult, Outlook


SUITES_HELP = f"What to run: {', '.join(suite.name for suite in SUITES)}."


def benchmark(
    context: typer.Context,
    suite: Annotated[str, option(SUITES_HELP, metavar="NAME")] = "quick",
    tracks: Annotated[
        list[str] | None,
        option("An environment; repeatable.", "--track", metavar="ID", default="the suite's own"),
    ] = None,
    tables: Annotated[
        list[str] | None,
        option("A table of the suite; repeatable.", "--table", metavar="NAME", default="all"),
    ] = None,
    agents: Annotated[
        list[str] | None,
        option("An agent; repeatable.", "--agent", metavar="NAME", default="the tables' own"),
    ] = None,
    adversaries: Annotated[
        list[str] | None,
        option(
            "A name, `name:preset`, `module:Class` or `ideal`; repeatable.",
            *("--adversary", "-a"),
            metavar="NAME",
            default="the suite's own",
        ),
    ] = None,
    seeds: Annotated[
        int | None, option("Seeds on every track.", minimum=1, default="the suite's own")
    ] = None,
    budget: Annotated[
        int | None, option("Training queries.", minimum=1, default="the tables' own")
    ] = None,
    samples: Annotated[
        int | None, option("Test samples.", minimum=1, default="the environments' own")
    ] = None,
    images: Annotated[
        int | None,
        option(
            "Samples, on the first seed, whose nearest queries are compared as images.",
            minimum=0,
            default="the suite's own",
        ),
    ] = None,
    workers: Annotated[int | None, option(WORKERS_HELP, minimum=1, default="the cores")] = None,
    executor: ExecutorName = "processes",
    out_folder: Annotated[
        Path | None,
        option(
            "Evaluations, costs, tables, pictures.",
            "--out",
            metavar="DIR",
            default="runs/benchmark-SUITE",
        ),
    ] = None,
    entries: Annotated[
        Path | None,
        option("Results, as entries of the leaderboard.", metavar="DIR", default="DIR/entries"),
    ] = None,
    references: Annotated[
        Path | None, option("The reference sets.", metavar="DIR", default="the shipped ones")
    ] = None,
    report: Annotated[
        bool, option("Run nothing; report what DIR holds by now.", "--report")
    ] = False,
    plan: Annotated[
        bool, option("Run nothing; say what there is to do and what it costs.", "--plan")
    ] = False,
) -> None:
    """Compare adversaries: every table, track, agent, adversary and seed.

    Call it again with the same DIR, after a stop at any moment or with more tracks, seeds or
    adversaries: finished runs are not repeated, outdated ones are. DIR receives
    entries/ with the results, table.md and pictures/ for readers, stores/ with all evaluations,
    and timings.jsonl. Another machine goes on with the entries alone.
    """
    folder = out_folder or Path("runs") / f"benchmark-{suite}"
    with errors_as_sentences():
        refuse_stray(context.args, "--track A --track B")
        if plan and report:
            raise UserError("Expected --plan or --report, got both. Leave one out.")
        from sada_gym.benchmark.run import plan_benchmark, report_benchmark, run_benchmark
        from sada_gym.cli.benchmark_progress import BenchmarkProgress
        from sada_gym.evaluation.executors import open_executor
        from sada_gym.measures.reference import FOLDER

        known = references or FOLDER
        if report:
            _show_result(report_benchmark(folder, known, entries=entries))
            return
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
        if plan:
            _show_outlook(plan_benchmark(chosen, folder, entries=entries, references=known))
            return
        # what a stopped process leaves is cleaned up, which is no news to the user
        sys.warnoptions.append("ignore:resource_tracker:UserWarning")
        progress = BenchmarkProgress(out)
        try:
            with open_executor(executor, workers or cores()) as opened, progress:
                result = run_benchmark(
                    chosen,
                    folder,
                    entries=entries,
                    workers=opened.workers,
                    executor=opened.executor,
                    references=known,
                    callback=progress,
                )
        except KeyboardInterrupt:
            show_resume_hint(_kept(progress.finished, folder, entries))
            raise typer.Exit(130) from None
    _show_result(result)


def _kept(runs: int, folder: Path, entries: Path | None) -> str:
    if entries is None:
        return f"{runs:,} finished runs and all evaluations are kept in {folder}."
    return f"{runs:,} finished runs are kept in {entries}, and all evaluations in {folder}."


def _show_outlook(outlook: Outlook) -> None:
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
            say("No run like these was timed yet, so the core hours are not known.")
        else:
            rest = f", without {unknown:,} runs of kinds that were never timed" if unknown else ""
            say(f"About {sum(cost.core_hours for cost in costs):.1f} core hours{rest}.")
    for note in outlook.notes:
        say(note, lead="[yellow]Warning:[/] ")


def _hours(cost: Estimate) -> str:
    if cost.unknown == cost.runs:
        return "unknown"
    return f"{cost.core_hours:.2f}" + (f" + {cost.unknown:,} unknown" if cost.unknown else "")


def _show_result(result: BenchmarkResult) -> None:
    results = result.results
    titles = {table.name: table.title for table in results.tables}
    for name, agent in results.comparisons():
        title = f"{titles[name]} · {agent}" if agent else titles[name]
        table = Table(title=title, header_style="bold", title_justify="left")
        for column in ("adversary", "AFR, %", "rank", "coverage / ideal, %", "rank", "runs"):
            table.add_column(column, justify="left" if column == "adversary" else "right")
        for row in results.rows_of(name, agent, None):
            cells = [escape(row.label)]
            for figure in (row.afr, row.relative_coverage):
                cells.append(f"{100 * figure.value:.1f}" if figure else "-")
                cells.append((figure and figure.rank) or "")
            failed = f" ({row.failed} failed)" if row.failed else ""
            table.add_row(*cells, f"{row.runs}{failed}")
        out.print(table)
    for note in result.notes:
        say(note, lead="[yellow]Warning:[/] ")
    say(f"Results: {result.entries}/; to read: {result.folder}/ (table.md, pictures/)")
