"""`sada-gym attack`: train an adversary against an agent, and say how often it fools it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from sada_gym.cli.console import (
    check_no_stray_words,
    cores,
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
    show_resume_hint,
    stop_code,
    stoppable,
    workers_option,
)
from sada_gym.errors import UserError
from sada_gym.experiment.names import check_spelling, default_note
from sada_gym.foundations.ids import names_file

if TYPE_CHECKING:
    from sada_gym.run import Run

_MAX_WORKERS = 8  # more seldom help, and each holds its own simulator


def attack(
    context: typer.Context,
    env_id: str = typer.Argument(
        metavar="ID|FILE.toml",
        help="The environment (`sada-gym envs` lists them), or a file that describes one.",
    ),
    adversary: str = option(
        "level-set", "The adversary; `sada-gym adversaries` lists them.", "--adversary", "-a"
    ),
    preset: str | None = option(None, "A named set of the adversary's options, such as `paper`."),
    env_kwargs: list[str] | None = env_kwargs_option(),
    agent: str | None = option(
        None,
        "The agent under test: a shipped one, or a .safetensors file of weights.",
        metavar="NAME|FILE",
    ),
    set_: list[str] | None = option(
        None, "An option of the adversary, such as steps=600; repeatable.", "--set", metavar="k=v"
    ),
    budget: int = option(
        2_000, "The number of training queries; 0 works with `random` and `ideal`.", minimum=0
    ),
    samples: int | None = option(
        None, "The number of test samples.", minimum=1, shown="the environment's own"
    ),
    seed: int = option(0, "Fixes the whole result.", minimum=0),
    workers: int | None = workers_option(None, f"the cores, at most {_MAX_WORKERS}"),
    executor: str = executor_option(),
    out_folder: Path | None = option(
        None, "Results.", "--out", metavar="DIR", shown="runs/ID-ADVERSARY-SEED"
    ),
    diagnose: bool = option(
        True,
        "Find the weaknesses. This costs 5 % more evaluations: at most 200, at least 15 for each "
        "rule and 15 elsewhere.",
    ),
    confirm: int | None = option(
        None,
        "On how many fresh seeds to try each failing sample again.",
        minimum=0,
        shown="2, for as many failures as fit into 5 % more evaluations",
    ),
    resume: bool = option(False, "Continue the run in DIR.", "--resume"),
    no_report: bool = option(False, "Write no report.html.", "--no-report"),
    as_json: bool = json_option("result.json"),
) -> None:
    """Train an adversary against an agent and measure how often its samples fool it.

    DIR receives report.html for people, result.json (the attack fooling rate with its interval,
    and all settings), diagnosis.json (the weaknesses), worlds.csv, samples.npz, pictures, the
    trained adversary, and run.sqlite, which holds every evaluation. You can stop a run at any
    moment: --resume continues it, and the result is the same.
    """
    track = Path(env_id).stem if names_file(env_id) else env_id
    folder = out_folder or Path("runs") / f"{track}-{adversary}-{seed}".replace(":", "-")
    with errors_as_sentences():
        check_no_stray_words(context.args, "--set a=1 --set b=2")
        keywords = key_values(env_kwargs, "--env-kwargs")
        if agent is not None:
            if "agent" in keywords:
                raise UserError("Expected the agent once, got it by --agent and --env-kwargs.")
            keywords["agent"] = agent
        options = key_values(set_, "--set")
        if preset is not None and "preset" in options:
            raise UserError("Expected the preset once, got it by --preset and --set.")
        check_spelling(env_id, adversary, keywords)
        if (note := default_note(env_id, keywords)) is not None:
            say(note, console=err)
        if resume and (folder / "result.json").exists():
            say(f"{folder} holds a finished run. It is shown, not repeated.", console=err)
        if confirm:
            say(f"Confirming costs {confirm} more evaluations for each failure.", console=err)
        from sada_gym.attacks import attack as run_attack
        from sada_gym.evaluation.executors import open_executor
        from sada_gym.experiment.progress import AttackProgress

        try:
            with (
                stoppable(),
                open_executor(executor, workers or min(cores(), _MAX_WORKERS)) as opened,
                AttackProgress(err) as progress,
            ):
                run = run_attack(
                    env_id,
                    adversary,
                    workers=opened.workers,
                    env_kwargs=keywords,
                    preset=preset,
                    options=options,
                    budget=budget,
                    samples=samples,
                    seed=seed,
                    out=folder,
                    diagnose=diagnose,
                    confirm=confirm,
                    resume=resume,
                    html=not no_report,
                    on_progress=progress,
                )
        except KeyboardInterrupt as stop:
            _show_stop(folder)
            raise typer.Exit(stop_code(stop)) from None
    if as_json:
        print_json(run.result)
    else:
        _show_result(run)


def _show_stop(folder: Path) -> None:
    from sada_gym.errors import StoreError
    from sada_gym.evaluation.store import EvaluationStore
    from sada_gym.run.folder import STORE_FILE

    path, kept = folder / STORE_FILE, "No evaluation"
    if path.exists():
        try:
            with EvaluationStore(path) as store:
                kept = f"{len(store):,} evaluations" if len(store) else kept
        except StoreError:  # a stop at a bad moment leaves it open; what is in it is safe
            kept = "The evaluations"
    if kept == "No evaluation":
        say("\nStopped before the first evaluation. Nothing was saved.", console=err)
    else:
        show_resume_hint(f"{kept} are saved in {path}.", "--resume")


def _show_result(run: Run) -> None:
    from rich.text import Text

    from sada_gym.run.summary import RATES, WHERE, WIDTH, laid_out

    width = min(WIDTH, out.width) if out.is_terminal else WIDTH
    say(run.title, lead="[bold]")
    for name, lead, text in laid_out([*run.rows(), *run.further()], width):
        style = "not dim bold" if name in (RATES, WHERE) else "not dim"
        out.print(Text(lead, style="dim").append(text, style), soft_wrap=True)
