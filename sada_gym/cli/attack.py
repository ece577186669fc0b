"""`sada-gym attack`: train an adversary against an agent, and say how often it fools it."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.panel import Panel
from rich.table import Table

from sada_gym.cli.console import cores, err, key_values, out, told_in_a_sentence
from sada_gym.errors import UserError

_MANY = 8  # more workers than this seldom help and each holds its own simulator


def attack(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="The environment; `sada-gym envs` lists them.")
    ],
    adversary: Annotated[
        str, typer.Option("--adversary", "-a", help="`sada-gym adversaries` lists them.")
    ] = "bbgan",
    preset: Annotated[
        str | None, typer.Option(help="A named set of the adversary's options, such as `paper`.")
    ] = None,
    env_kwargs: Annotated[
        list[str] | None,
        typer.Option(metavar="k=v ...", help="Keywords of the environment: object_class=car."),
    ] = None,
    agent: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="The agent under test: a shipped one, or weights."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="k=v ...", help="Options of the adversary: steps=600."),
    ] = None,
    budget: Annotated[int, typer.Option(min=0, help="Number of training queries.")] = 2_000,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Number of test samples.", show_default="the environment's own"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Fixes the whole result.")] = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Processes; the result does not depend on it.",
            show_default=f"the cores, at most {_MANY}",
        ),
    ] = None,
    out_folder: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Results.", show_default="runs/ID-ADVERSARY-SEED"
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the run that DIR holds.")
    ] = False,
) -> None:
    """Train an adversary against an agent and measure how often its samples fool it.

    DIR receives result.json (the attack fooling rate with its interval, and all settings),
    samples.npz, pictures, the trained adversary, and run.sqlite, which holds every evaluation:
    a run that was stopped at any moment goes on with --resume and ends with the same result.
    """
    folder = out_folder or Path("runs") / f"{env_id}-{adversary}-{seed}".replace(":", "-")
    count = workers or min(cores(), _MANY)
    with told_in_a_sentence():
        keywords = key_values(env_kwargs or [], "--env-kwargs")
        if agent is not None:
            if "agent" in keywords:
                raise UserError("Expected the agent once, got it by --agent and --env-kwargs.")
            keywords["agent"] = agent
        options = key_values(set_ or [], "--set")
        if preset is not None and "preset" in options:
            raise UserError("Expected the preset once, got it by --preset and --set.")
        try:
            _run(
                env_id,
                adversary,
                env_kwargs=keywords,
                preset=preset,
                options=options,
                budget=budget,
                samples=samples,
                seed=seed,
                workers=count,
                out=folder,
                resume=resume,
            )
        except KeyboardInterrupt:
            command = ["sada-gym", "attack", env_id, "--adversary", adversary]
            command += ["--preset", preset] if preset else []
            command += ["--agent", agent] if agent else []
            command += [part for pair in env_kwargs or [] for part in ("--env-kwargs", pair)]
            command += [part for pair in set_ or [] for part in ("--set", pair)]
            command += ["--budget", str(budget)]
            command += ["--samples", str(samples)] if samples else []
            command += ["--seed", str(seed), "--workers", str(count), "--out", str(folder)]
            _tell_how_to_resume(folder, [*command, "--resume"])
            raise typer.Exit(130) from None


def _run(env_id: str, adversary: str, **settings: Any) -> None:
    from sada_gym.attack import attack as run_attack
    from sada_gym.cli.progress import AttackBars

    with AttackBars(out, adversary) as bars:
        result = run_attack(env_id, adversary, on_progress=bars, **settings)
    _summarise(result)


def _summarise(result: Any) -> None:
    from sada_gym.measures.rates import attack_fooling_rate

    report, folder = result.report, result.folder
    rate = attack_fooling_rate(result.samples.score, report.fooling_threshold)
    table = Table.grid(padding=(0, 3))
    table.add_column(style="dim")
    table.add_column()
    table.add_row(
        "attack fooling rate", f"[bold]{rate}[/], {rate.fooled} of {rate.samples} samples"
    )
    if report.feasible is not None and report.feasible.afr is not None:
        table.add_row(
            "over feasible worlds",
            f"{report.feasible.afr:.1%}".replace("%", " %")
            + f", {report.feasible.fooled} of {report.feasible.worlds} samples",
        )
    if report.search.queries:
        table.add_row(
            "in training",
            f"{report.search.fooling_rate:.1%}".replace("%", " %")
            + f" of {report.search.queries:,} queries fooled the agent",
        )
    table.add_row("spread (mu_std)", f"{report.mu_std:.3f}; uniform would be 0.577")
    if report.nearest_fooling_query is not None:
        table.add_row(
            "novelty",
            f"median distance {report.nearest_fooling_query.median:.3f} "
            "to the nearest training query that fooled",
        )
    for flag in report.flags:
        table.add_row("[yellow]mind[/]", escape(flag))
    table.add_row("results", f"{folder}/")
    table.add_row("pictures", ", ".join(path.name for path in result.pictures))
    title = f"{report.settings.track} · {report.settings.adversary}"
    out.print(Panel(table, title=title, expand=False, highlight=False))


def _tell_how_to_resume(folder: Path, command: list[str]) -> None:
    from sada_gym.evaluation.store import EvaluationStore
    from sada_gym.runs.record import STORE_FILE

    kept, path = 0, folder / STORE_FILE
    if path.exists():
        with EvaluationStore(path) as store:
            kept = len(store)
    err.print(f"\nStopped. {kept:,} evaluations are kept in {path}.", highlight=False)
    err.print("Resume with:", highlight=False)
    err.print(f"  {shlex.join(command)}", markup=False, highlight=False, soft_wrap=True)
