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
    cores,
    errors_as_sentences,
    out,
    refuse_stray,
    say,
    show_resume_hint,
)
from sada_gym.cli.executor import EXECUTOR_HELP, PROCESSES, open_named

if TYPE_CHECKING:
    from sada_gym.benchmark.run import BenchmarkResult


SUITES_HELP = f"What to run: {', '.join(suite.name for suite in SUITES)}."


def benchmark(
    context: typer.Context,
    suite: Annotated[str, typer.Option(metavar="NAME", help=SUITES_HELP)] = "quick",
    tracks: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID", help="An environment; repeatable.", show_default="the suite's own"
        ),
    ] = None,
    tables: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A table of the suite; repeatable.", show_default="all"),
    ] = None,
    agents: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="An agent; repeatable.", show_default="the tables' own"),
    ] = None,
    adversaries: Annotated[
        list[str] | None,
        typer.Option(
            "--adversaries",
            "-a",
            metavar="NAME",
            help="A name, `name:preset`, `module:Class` or `ideal`; repeatable.",
            show_default="the suite's own",
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, help="Seeds on every track.", show_default="the suite's own"),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(min=1, help="Training queries.", show_default="the tables' own"),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Test samples.", show_default="the environments' own"),
    ] = None,
    images: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Samples, on the first seed, whose nearest queries are compared as images.",
            show_default="the suite's own",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, help="Processes; the result does not depend on it.", show_default="the cores"
        ),
    ] = None,
    executor: Annotated[str, typer.Option(metavar="NAME", help=EXECUTOR_HELP)] = PROCESSES,
    out_folder: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Results.", show_default="runs/benchmark-SUITE"),
    ] = None,
    references: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="The reference sets.", show_default="the shipped ones"),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Run nothing; report what DIR holds by now.")
    ] = False,
) -> None:
    """Compare adversaries: every table, track, agent, adversary and seed.

    Call it again with the same DIR, after a stop at any moment or with more tracks, seeds or
    adversaries: what is finished is not repeated. DIR receives results.json, table.md, pictures/
    and timings.json; runs/ holds each run, stores/ all evaluations.
    """
    folder = out_folder or Path("runs") / f"benchmark-{suite}"
    with errors_as_sentences():
        refuse_stray(context.args, "--tracks A --tracks B")
        from sada_gym.benchmark.run import report_benchmark, run_benchmark
        from sada_gym.cli.benchmark_progress import BenchmarkProgress
        from sada_gym.measures.reference import FOLDER

        known = references or FOLDER
        if report:
            _show_result(report_benchmark(folder, known))
            return
        chosen = choose(
            find_suite(suite),
            tracks=tracks or (),
            tables=tables or (),
            contenders=adversaries or (),
            agents=agents or (),
            seeds=seeds,
            budget=budget,
            samples=samples,
            images=images,
        )
        # what a stopped process leaves is cleaned up, which is no news to the user
        sys.warnoptions.append("ignore:resource_tracker:UserWarning")
        try:
            with (
                open_named(executor, workers or cores()) as (opened, count),
                BenchmarkProgress(out) as progress,
            ):
                result = run_benchmark(
                    chosen,
                    folder,
                    workers=count,
                    executor=opened,
                    references=known,
                    callback=progress,
                )
        except KeyboardInterrupt:
            show_resume_hint(_kept(folder))
            raise typer.Exit(130) from None
    _show_result(result)


def _kept(folder: Path) -> str:
    """Say what a stopped benchmark has kept."""
    from sada_gym.benchmark.folder import finished_runs

    return f"{len(finished_runs(folder)):,} finished runs and all evaluations are kept in {folder}."


def _show_result(result: BenchmarkResult) -> None:
    results = result.results
    titles = {table.name: table.title for table in results.settings.tables}
    for name, agent in results.comparisons():
        title = f"{titles[name]} · {agent}" if agent else titles[name]
        table = Table(title=title, header_style="bold", title_justify="left")
        for column in ("adversary", "AFR, %", "rank", "coverage / ideal, %", "rank", "runs"):
            table.add_column(column, justify="left" if column == "adversary" else "right")
        for row in results.rows_of(name, agent, None):
            figures = (row.afr, row.relative_coverage)
            cells = [
                text
                for figure in figures
                for text in (
                    f"{100 * figure.value:.1f}" if figure else "-",
                    (figure.rank or "") if figure else "",
                )
            ]
            failed = f" ({row.failed} failed)" if row.failed else ""
            table.add_row(escape(row.label), *cells, f"{row.runs}{failed}")
        out.print(table)
    for note in result.notes:
        say("[yellow]Mind:[/] ", note)
    say("", f"Results: {result.folder}/ (results.json, table.md, pictures/)")
