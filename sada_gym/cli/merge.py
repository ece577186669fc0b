"""`sada-gym merge`: the results of several benchmarks in one report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sada_gym.cli.console import errors_as_sentences, option, say


def merge(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULTS ...", help="results.json, or their folders.")
    ],
    out_folder: Annotated[Path, option("The report.", "--out", metavar="DIR")],
    tables: Annotated[
        list[str] | None, option("A table to take over; repeatable.", metavar="NAME", default="all")
    ] = None,
    tracks: Annotated[
        list[str] | None,
        option("An environment to take over; repeatable.", metavar="ID", default="all"),
    ] = None,
    adversaries: Annotated[
        list[str] | None,
        option(
            "A row to take over, as the tables name it; repeatable.",
            *("--adversaries", "-a"),
            metavar="NAME",
            default="all",
        ),
    ] = None,
) -> None:
    """Put the results of several benchmarks into one: other applications, seeds or machines.

    DIR receives results.json and table.md, as if one benchmark had run it all.
    """
    with errors_as_sentences():
        from sada_gym.benchmark.merge import merge_files

        merged = merge_files(
            results,
            out_folder,
            tables=tables or (),
            tracks=tracks or (),
            contenders=adversaries or (),
        )
    text = f"{len(merged.runs):,} runs, {len(merged.targets)} tracks and agents: "
    say("", f"{text}{out_folder}/ (results.json, table.md)")
