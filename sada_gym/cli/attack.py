"""`sada-gym attack`: train an adversary against an agent, and say how often it fools it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from sada_gym import adversaries
from sada_gym.cli.console import (
    WORKERS_HELP,
    ExecutorName,
    cores,
    errors_as_sentences,
    key_values,
    option,
    out,
    refuse_stray,
    say,
    show_resume_hint,
)
from sada_gym.errors import UserError
from sada_gym.registration import names_file

if TYPE_CHECKING:
    from sada_gym.attack import AttackResult
    from sada_gym.runs.record import RunReport

_AFR = "attack fooling rate"
_MANY = 8  # more workers than this seldom help and each holds its own simulator


def attack(
    context: typer.Context,
    env_id: Annotated[
        str,
        typer.Argument(
            metavar="ID|FILE.toml",
            help="The environment; `sada-gym envs` lists them. Or a file that describes one.",
        ),
    ],
    adversary: Annotated[
        str, option("`sada-gym adversaries` lists them.", "--adversary", "-a")
    ] = "bbgan",
    preset: Annotated[
        str | None, option("A named set of the adversary's options, such as `paper`.")
    ] = None,
    env_kwargs: Annotated[
        list[str] | None,
        option("A keyword of the environment, as object_class=car; repeatable.", metavar="k=v"),
    ] = None,
    agent: Annotated[
        str | None,
        option("The agent under test: a shipped one, or weights.", metavar="NAME|FILE"),
    ] = None,
    set_: Annotated[
        list[str] | None,
        option("An option of the adversary, as steps=600; repeatable.", "--set", metavar="k=v"),
    ] = None,
    budget: Annotated[int, option("Number of training queries.", least=0)] = 2_000,
    samples: Annotated[
        int | None, option("Number of test samples.", least=1, default="the environment's own")
    ] = None,
    seed: Annotated[int, option("Fixes the whole result.", least=0)] = 0,
    workers: Annotated[
        int | None, option(WORKERS_HELP, least=1, default=f"the cores, at most {_MANY}")
    ] = None,
    executor: ExecutorName = "processes",
    out_folder: Annotated[
        Path | None, option("Results.", "--out", metavar="DIR", default="runs/ID-ADVERSARY-SEED")
    ] = None,
    resume: Annotated[bool, option("Go on with the run that DIR holds.", "--resume")] = False,
) -> None:
    """Train an adversary against an agent and measure how often its samples fool it.

    DIR receives result.json (the attack fooling rate with its interval, and all settings),
    samples.npz, pictures, the trained adversary, and run.sqlite, which holds every evaluation: a
    run that was stopped at any moment goes on with --resume and ends with the same result.
    """
    track = Path(env_id).stem if names_file(env_id) else env_id
    folder = out_folder or Path("runs") / f"{track}-{adversary}-{seed}".replace(":", "-")
    with errors_as_sentences():
        refuse_stray(context.args, "--set a=1 --set b=2")
        keywords = key_values(env_kwargs or [], "--env-kwargs")
        if agent is not None:
            if "agent" in keywords:
                raise UserError("Expected the agent once, got it by --agent and --env-kwargs.")
            keywords["agent"] = agent
        options = key_values(set_ or [], "--set")
        if preset is not None and "preset" in options:
            raise UserError("Expected the preset once, got it by --preset and --set.")
        from sada_gym.attack import attack as run_attack
        from sada_gym.cli.progress import AttackProgress
        from sada_gym.evaluation.executors import open_executor

        try:
            with (
                open_executor(executor, workers or min(cores(), _MANY)) as opened,
                AttackProgress(out) as progress,
            ):
                result = run_attack(
                    env_id,
                    adversary,
                    executor=opened.executor,
                    workers=opened.workers,
                    env_kwargs=keywords,
                    preset=preset,
                    options=options,
                    budget=budget,
                    samples=samples,
                    seed=seed,
                    out=folder,
                    resume=resume,
                    on_progress=lambda now: progress(now.stage, now.done, now.total, now.known),
                )
        except KeyboardInterrupt:
            show_resume_hint(_kept(folder), "--resume")
            raise typer.Exit(130) from None
    _show_result(result)


def _show_result(result: AttackResult) -> None:
    settings = result.report.settings
    say("[bold]", f"{settings.track} · {settings.adversary}")
    table = Table.grid(padding=(0, 3), pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for name, text in _rows(result):
        table.add_row(f"  {name}", Text(text, style="bold" if name == _AFR else ""))
    out.print(table, highlight=False)
    files = ["result.json", *(path.name for path in result.pictures)]
    say("", f"Results: {result.folder}/ ({', '.join(files)})")


def _rows(result: AttackResult) -> Iterator[tuple[str, str]]:
    """Name and text of each figure that the summary shows."""
    report = result.report
    low, high = report.afr_interval_95
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f}"
    of_samples = f"{report.fooled} of {report.settings.samples:,} samples"
    yield _AFR, f"{_percent(report.afr)} ({interval}), {of_samples}"
    yield "uniform worlds", _uniform_rate(report)
    feasible = report.feasible
    if feasible is not None and feasible.afr is not None:
        yield (
            "over feasible worlds",
            f"{_percent(feasible.afr)}, {feasible.fooled} of {feasible.worlds} samples",
        )
    if report.search.fooling_rate is not None:
        rate = _percent(report.search.fooling_rate)
        yield "in training", f"{rate} of {report.search.queries:,} queries fooled the agent"
    yield "spread (mu_std)", f"{report.mu_std:.3f}; uniform would be 0.577"
    if report.relative_coverage is not None:
        yield "coverage", f"{_percent(report.relative_coverage)}; ideal samples would be 100 %"
    if report.nearest_fooling_query is not None:
        distance = f"median distance {report.nearest_fooling_query.median:.3f}"
        yield "novelty", f"{distance} to the nearest training query that fooled"
    for flag in report.flags:
        yield "mind", flag


def _uniform_rate(report: RunReport) -> str:
    """Say how often uniform worlds fool the agent, and where the figure is from."""
    settings, reference = report.settings, report.settings.reference
    if reference is not None:
        return f"{_percent(reference.uniform_rate)} (reference set of {reference.points:,} points)"
    if settings.adversary == "random":
        return f"{_percent(report.afr)} (these samples are uniform)"
    rate = report.search.fooling_rate
    if rate is not None and adversaries.find(settings.adversary).uniform_queries:
        return f"{_percent(rate)} (its {report.search.queries:,} training queries are uniform)"
    return "not known: run --adversary random"


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"


def _kept(folder: Path) -> str:
    """Say what a stopped run has kept."""
    from sada_gym.evaluation.store import EvaluationStore
    from sada_gym.runs.record import STORE_FILE

    kept, path = 0, folder / STORE_FILE
    if path.exists():
        with EvaluationStore(path) as store:
            kept = len(store)
    return f"{kept:,} evaluations are kept in {path}."
