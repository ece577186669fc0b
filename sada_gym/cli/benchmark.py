"""`sada-gym benchmark`: many adversaries on many tracks under equal conditions."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table
from typer.core import TyperCommand

from sada_gym.cli.console import cores, err, out, spread, told_in_a_sentence

if TYPE_CHECKING:
    from sada_gym.benchmark.run import BenchmarkResult

_LISTS = ("--tracks", "--tables", "--agents", "--adversaries", "-a")


class ListingCommand(TyperCommand):
    """A command that takes `--tracks A B` for `--tracks A --tracks B`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option before each further value."""
        return super().parse_args(ctx, list(_spread(args)))


def _spread(args: Sequence[str]) -> Iterator[str]:
    return spread(args, _LISTS, lambda arg: True)  # noqa: ARG005 - any word is a value


def benchmark(
    suite: Annotated[
        str, typer.Option(help="`paper`: its budgets and equal ones, all classes; or `quick`.")
    ] = "quick",
    tracks: Annotated[
        list[str] | None,
        typer.Option(metavar="ID ...", help="The environments.", show_default="the suite's own"),
    ] = None,
    tables: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME ...", help="`paper-budgets`, `equal-queries`.", show_default="all"
        ),
    ] = None,
    agents: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME ...", help="The agents.", show_default="the tables' own"),
    ] = None,
    adversaries: Annotated[
        list[str] | None,
        typer.Option(
            "--adversaries",
            "-a",
            metavar="NAME ...",
            help="Names, `name:preset`, `module:Class`, `ideal`.",
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
    with told_in_a_sentence():
        from sada_gym.benchmark.run import report_benchmark, run_benchmark
        from sada_gym.benchmark.suite import choose, find_suite
        from sada_gym.cli.benchmark_progress import BenchmarkBars
        from sada_gym.measures.reference import FOLDER

        known = references or FOLDER
        if report:
            _summarise(report_benchmark(folder, known))
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
            with BenchmarkBars(out) as bars:
                result = run_benchmark(
                    chosen,
                    folder,
                    workers=workers or cores(),
                    references=known,
                    callback=bars,
                )
        except KeyboardInterrupt:
            _tell_how_to_resume(folder)
            raise typer.Exit(130) from None
    _summarise(result)


def _tell_how_to_resume(folder: Path) -> None:
    from sada_gym.benchmark.folder import finished_runs

    count = len(finished_runs(folder))
    err.print(
        f"\nStopped. {count:,} finished runs and all evaluations are kept in {folder}.",
        highlight=False,
    )
    err.print("Go on with the same command:", highlight=False)
    command = shlex.join(["sada-gym", *sys.argv[1:]])
    err.print(f"  {command}", markup=False, highlight=False, soft_wrap=True)


def _summarise(result: BenchmarkResult) -> None:
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
        out.print(f"[yellow]Mind:[/] {escape(note)}", highlight=False)
    names = "results.json, table.md, pictures/"
    out.print(f"Results: {result.folder}/ ({names})", highlight=False, soft_wrap=True)
