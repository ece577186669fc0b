"""`sada-gym confirm`: do the samples of a run fool in a slower, truer world as well?"""

from __future__ import annotations

from pathlib import Path

from sada_gym.cli.console import (
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


def confirm(
    run: Path = run_argument(),
    env_kwargs: list[str] | None = env_kwargs_option(),
    samples: int | None = option(None, "Take the first so many.", minimum=1, shown="all"),
    workers: int = workers_option(1),
    executor: str = executor_option(),
    out_file: Path | None = option(
        None,
        "The figures; the scores lie beside them.",
        "--out",
        metavar="FILE.json",
        shown="RUN/confirmed.json",
    ),
    as_json: bool = json_option("the figures"),
) -> None:
    """Score a run's samples again, with the same seeds, in its track with changed keywords.

    Search in a fast world, confirm in a slow one: --env-kwargs renderer=blender. RUN receives
    confirmed.json and confirmed.npz. The same command goes on after a stop.
    """
    with errors_as_sentences():
        keywords = key_values(env_kwargs, "--env-kwargs")
        from sada_gym.analyses.transfer import confirm as score_again
        from sada_gym.evaluation.executors import open_executor

        with open_executor(executor, workers) as opened, scores_progress() as progress:
            confirmation = score_again(
                run,
                keywords,
                samples=samples,
                out=out_file,
                workers=opened.workers,
                executor=opened.executor,
                on_scores=progress,
            )
    found = confirmation.comparison
    if as_json:
        print_json(found)
        return
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
    say(f"Results: {confirmation.path}, {confirmation.path.with_suffix('.npz').name}")
