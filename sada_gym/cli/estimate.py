"""`sada-gym estimate`: how likely does the agent fail in ordinary use?"""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import typer

from sada_gym.cli.console import (
    application_option,
    env_kwargs_option,
    errors_as_sentences,
    executor_option,
    json_option,
    key_values,
    option,
    print_json,
    say,
    scores_progress,
    workers_option,
)
from sada_gym.cli.report import make_anew
from sada_gym.errors import UserError


def estimate(
    what: str = typer.Argument(
        metavar="RUN|ID|FILE.toml", help="The folder of a run, or what to evaluate."
    ),
    budget: int = option(2_000, "The number of fresh evaluations.", minimum=20),
    seed: int = option(0, "Fixes the whole result.", minimum=0),
    density: list[str] | None = option(
        None,
        "A parameter's density in ordinary use; repeatable; parameters without one are then "
        "uniform. Or a table of logged worlds, to which a density is fitted.",
        metavar='NAME={"normal": [MEAN, SD]}|FILE.csv',
        shown="those of the environment",
    ),
    env_kwargs: list[str] | None = env_kwargs_option(),
    workers: int = workers_option(1),
    executor: str = executor_option(),
    application: str | None = application_option(),
    store: Path | None = option(
        None,
        "Save the scores, so that the command can continue after a stop.",
        metavar="FILE",
        shown="the folder of a run",
    ),
    beside: str | None = option(
        None,
        "Compare with another agent in the same worlds: how many times as often does the first "
        "one fail?",
        metavar="AGENT|RUN|FILE.toml",
    ),
    per: int | None = option(
        None, "Also print how many of this many uses fail, such as 1000.", minimum=1
    ),
    unit: str | None = option(
        None, "What one episode is called in that line, such as flights.", metavar="WORD"
    ),
    as_json: bool = json_option("the estimate"),
) -> None:
    """Estimate how likely an agent fails in ordinary use, with a 95 % interval.

    RUN receives estimate.json, and its report.html, if any, is updated. After a stop, the same
    command continues.
    """
    with errors_as_sentences():
        keywords = key_values(env_kwargs, "--env-kwargs")
        given = density or []
        tables = [text for text in given if text.lower().endswith((".csv", ".tsv"))]
        if tables and len(given) > 1:
            raise UserError(
                f"Expected --density once where it names a table, got {' and '.join(given)}. "
                "Write one table that holds all parameters, or NAME=DENSITY for each."
            )
        densities = tables[0] if tables else key_values(given, "--density")
        from sada_gym.analyses.estimation.estimate import estimate as find
        from sada_gym.evaluation.executors import open_executor
        from sada_gym.run.folder import SETTINGS_FILE

        folder = Path(what)
        is_run = (folder / SETTINGS_FILE).is_file()
        kept = is_run or store is not None
        begun, fresh = monotonic(), 0

        with open_executor(executor, workers) as opened, scores_progress(kept=kept) as progress:

            def on_scores(done: int, total: int, cached: int) -> None:
                nonlocal fresh
                fresh = done - cached
                progress(done, total, cached)

            result = find(
                what,
                budget=budget,
                seed=seed,
                density=densities or None,
                env_kwargs=keywords,
                application=application,
                workers=opened.workers,
                store=store,
                beside=beside,
                per=per,
                unit=unit,
                on_scores=on_scores,
            )
        seconds = monotonic() - begun
        if is_run:
            make_anew(folder, application)
    if as_json:
        print_json(result)
        return
    for name, text in result.rows():
        if name == "to halve this interval" and fresh and result.to_halve:
            minutes = result.to_halve * seconds / fresh / 60.0
            text = f"{text}, {minutes:,.0f} minutes" if minutes >= 1.5 else f"{text}, a minute"
        say(f"{name}: {text}.", lead="[bold]" if name == "in ordinary use" else "")
