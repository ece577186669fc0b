"""`sada-gym transfer`: do the samples of a run fool elsewhere, too?"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sada_gym.cli.console import (
    application_option,
    env_kwargs_option,
    err,
    errors_as_sentences,
    executor_option,
    json_option,
    key_values,
    option,
    out,
    print_json,
    say,
    scores_progress,
    workers_option,
)

if TYPE_CHECKING:
    from sada_gym.analyses.rescore import Comparison
    from sada_gym.measures.rates import Rate


def transfer(
    runs: list[Path] = typer.Argument(
        metavar="RUN...", help="Folders that `sada-gym attack` wrote."
    ),
    to: list[str] | None = option(
        None,
        "Where to score the samples; repeatable.",
        "--to",
        metavar="ID|FILE.toml",
        shown="each run's own track",
    ),
    agent: str | None = option(
        None, "The agent to score.", metavar="NAME|FILE", shown="the run's, else the track's"
    ),
    env_kwargs: list[str] | None = env_kwargs_option(),
    samples: int | None = option(
        None, "Use only this many samples of each run.", minimum=1, shown="all"
    ),
    seed: int | None = option(
        None, "Draw other evaluation seeds.", minimum=0, shown="those of the samples"
    ),
    workers: int = workers_option(1),
    executor: str = executor_option(),
    application: str | None = application_option(),
    out_file: Path | None = option(None, "Write the figures as JSON.", "--out", metavar="FILE"),
    as_json: bool = json_option("the figures"),
) -> None:
    """Score the samples of runs in other tracks, against other agents, with other keywords.

    A sample keeps its physical values. Its scores are saved in the run's folder: after a stop, the
    same command continues.
    """
    with errors_as_sentences():
        keywords = key_values(env_kwargs, "--env-kwargs")
        from sada_gym.analyses.rescore import transfer as score_elsewhere
        from sada_gym.evaluation.executors import open_executor
        from sada_gym.foundations.files import write_model

        with open_executor(executor, workers) as opened, scores_progress() as progress:
            transfers = score_elsewhere(
                runs,
                to or (),
                agent=agent,
                env_kwargs=keywords,
                samples=samples,
                seed=seed,
                workers=opened.workers,
                application=application,
                on_scores=progress,
            )
        if out_file is not None:
            write_model(out_file, transfers)
    if as_json:
        print_json(transfers)
        return
    for place, rows in groupby(transfers.comparisons, key=lambda row: row.run):
        _show(place, list(rows))


def _show(run: str, rows: Sequence[Comparison]) -> None:
    first = min(rows, key=lambda row: row.invalid)
    lines = [
        ("", "AFR", "fool in both", "rank correlation", "ordinary worlds"),
        ("in the run", str(first.afr_here), "", "", ""),
        *(
            (_place(row), str(row.afr_there), _of(row.both), _rank(row), _of(row.ordinary))
            for row in rows
        ),
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    say(
        f"{first.adversary} on {first.here}, seed {first.seed}: {first.afr_here.samples} samples "
        f"of {run}",
        lead="[bold]",
    )
    for line in lines:
        cells = "   ".join(text.ljust(width) for text, width in zip(line, widths, strict=True))
        out.print(f"  {cells}".rstrip(), markup=False, highlight=False, soft_wrap=True)
    for row in rows:
        show_notes(row)


def _place(row: Comparison) -> str:
    keywords = ", ".join(f"{name}={value}" for name, value in row.keywords.items())
    return f"{row.there}{f' with {keywords}' if keywords else ''}"


def _of(rate: Rate | None) -> str:
    return "-" if rate is None else f"{rate.fooled} of {rate.samples}"


def _rank(row: Comparison) -> str:
    return "-" if row.rank_correlation is None else f"{row.rank_correlation:.2f}"


def show_notes(comparison: Comparison) -> None:
    """Say which samples were moved into the ranges of another world, or count in no figure."""
    if comparison.invalid:
        say(
            f"{comparison.invalid} samples of {comparison.adversary} are left out: their worlds "
            f"broke in the run or in {comparison.there}.",
            lead="[dim]",
            console=err,
        )
    for name, count in comparison.clipped.items():
        total = comparison.afr_here.samples + comparison.invalid
        say(
            f"{count} of {total} samples of {comparison.adversary} lie outside the range of {name} "
            f"in {comparison.there}: they were moved to its end.",
            lead="[dim]",
            console=err,
        )
