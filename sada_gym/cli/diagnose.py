"""`sada-gym diagnose`: the few rules that say how a run's agent fails."""

from __future__ import annotations

from pathlib import Path

from sada_gym.cli.console import (
    application_option,
    errors_as_sentences,
    json_option,
    option,
    print_json,
    run_argument,
    say,
    scores_progress,
    workers_option,
)
from sada_gym.cli.report import make_anew


def diagnose(
    run: Path = run_argument(),
    fresh: int | None = option(
        None,
        "How many fresh worlds check the rules.",
        minimum=0,
        shown="5 % of the run's budget, at most 200, but at least 15 a rule and 15 elsewhere",
    ),
    confirm: int = option(
        0, "On how many fresh seeds to try each failing sample again.", minimum=0
    ),
    workers: int = workers_option(1),
    application: str | None = application_option(),
    as_json: bool = json_option("the diagnosis"),
) -> None:
    """Find one to five weaknesses: rules over physical parameters where the agent fails.

    RUN receives diagnosis.json, and its report.html, if any, is updated. After a stop, the same
    command continues.
    """
    with errors_as_sentences():
        from sada_gym.analyses.diagnose import diagnose as find
        from sada_gym.measures.diagnosis.summary import details

        with scores_progress() as progress:
            diagnosis = find(
                run,
                fresh=fresh,
                confirm=confirm,
                application=application,
                workers=workers,
                on_scores=progress,
            )
        make_anew(run, application)
    if as_json:
        print_json(diagnosis)
        return
    for line in details(diagnosis):
        say(line, lead="" if line.startswith(" ") else "[bold]")
