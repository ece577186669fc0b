"""`sada-gym confirm`: do the failures of a run fail again, on fresh seeds or in a truer world?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sada_gym.cli.console import (
    application_option,
    env_kwargs_option,
    errors_as_sentences,
    executor_option,
    json_option,
    key_values,
    option,
    print_json,
    run_argument,
    say,
    scores_progress,
    workers_option,
)
from sada_gym.cli.transfer import show_notes
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from sada_gym.analyses.rescore import Comparison

_SEEDS = 3


def confirm(
    run: Path = run_argument(),
    env_kwargs: list[str] | None = env_kwargs_option(),
    seeds: int | None = option(
        None, "On how many fresh seeds to try each failure.", minimum=1, shown=f"{_SEEDS}"
    ),
    samples: int | None = option(
        None, "With --env-kwargs: use only this many samples.", minimum=1, shown="all"
    ),
    workers: int = workers_option(1),
    executor: str = executor_option(),
    application: str | None = application_option(),
    out_file: Path | None = option(
        None,
        "With --env-kwargs: the file for the figures; the scores go next to it.",
        "--out",
        metavar="FILE.json",
        shown="RUN/confirmed.json",
    ),
    as_json: bool = json_option("the figures"),
) -> None:
    """Try a run's failures again: on fresh seeds, or in its track with changed keywords.

    Search in a fast world, confirm in a slow one: --env-kwargs renderer=blender scores all samples
    again, with their seeds, and RUN receives confirmed.json and confirmed.npz. After a stop, the
    same command continues.
    """
    with errors_as_sentences():
        keywords = key_values(env_kwargs, "--env-kwargs")
        if keywords and (seeds is not None or application is not None):
            raise UserError(
                "Expected either fresh seeds or changed keywords, got both. Leave out --seeds and "
                "--application, or --env-kwargs."
            )
        if not keywords and (samples is not None or out_file is not None):
            raise UserError(
                "Expected --samples and --out with --env-kwargs, got them without. Name the "
                "keywords that change, such as --env-kwargs renderer=blender."
            )
        from sada_gym.analyses.failures import confirm_failures
        from sada_gym.analyses.rescore import CONFIRMED_FILE
        from sada_gym.analyses.rescore import confirm as in_changed_worlds
        from sada_gym.evaluation.executors import open_executor

        with open_executor(executor, workers) as opened, scores_progress() as progress:
            options: dict[str, Any] = {"workers": opened.workers, "on_scores": progress}
            if not keywords:
                failures = confirm_failures(
                    run, seeds or _SEEDS, application=application, **options
                )
            else:
                found = in_changed_worlds(
                    run, keywords, samples=samples, out=out_file, **options
                ).comparison
    if not keywords:
        if as_json:
            print_json(failures)
            return
        if failures is None:
            say("No sample of the run fooled the agent.")
            return
        say(failures.again)
        return
    if as_json:
        print_json(found)
        return
    _show(found, keywords)
    path = run / CONFIRMED_FILE if out_file is None else out_file
    say(f"Results: {path}, {path.with_suffix('.npz').name}")


def _show(found: Comparison, keywords: dict[str, Any]) -> None:
    changed = ", ".join(f"{name}={value}" for name, value in keywords.items())
    say(f"{found.adversary} on {found.here}, seed {found.seed}; with {changed}", lead="[bold]")
    say(f"  attack fooling rate there   {found.afr_there}; in the run {found.afr_here}")
    if found.both is not None:
        say(
            f"  confirmed                   {found.both} of the {found.both.samples} samples that "
            "fool in the run"
        )
    if found.new is not None:
        say(f"  new                         {found.new} of the {found.new.samples} that do not")
    if found.rank_correlation is not None:
        say(f"  rank correlation of scores  {found.rank_correlation:.2f}")
    show_notes(found)
