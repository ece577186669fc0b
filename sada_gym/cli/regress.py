"""`sada-gym regress`: is an agent better or worse in the worlds of a suite?"""

from __future__ import annotations

from pathlib import Path

import typer

from sada_gym.cli.console import (
    errors_as_sentences,
    json_option,
    option,
    print_json,
    say,
    scores_progress,
    workers_option,
)


def regress(
    suite: Path = typer.Argument(metavar="SUITE", help="What `sada-gym export` wrote."),
    agent: str = option(..., "The agent to test.", metavar="NAME|FILE"),
    baseline: str | None = option(
        None, "The agent to compare it with.", metavar="NAME|FILE", shown="the suite's results"
    ),
    margin: float | None = option(
        None,
        "Pass if, at 95 % confidence, the rate of failing worlds grows by less than this, such as "
        "0.05.",
        shown="an exact test alone",
    ),
    max_failing: int | None = option(
        None, "Fail if more worlds than this fail.", minimum=0, shown="any number may"
    ),
    require_fixed: float | None = option(
        None,
        "Fail if a smaller share of the known failures is fixed, such as 0.5.",
        shown="none has to be",
    ),
    max_probability: float | None = option(
        None,
        "Pass only if a failure in ordinary use is less likely than this, such as 1e-3; fail if "
        "it is more likely (95 %).",
        shown="not estimated",
    ),
    budget: int = option(2_000, "Evaluations for --max-probability.", minimum=20),
    workers: int = workers_option(1),
    junit: Path | None = option(None, "Write JUnit XML.", metavar="FILE"),
    markdown: Path | None = option(None, "Write Markdown for a pull request.", metavar="FILE"),
    store: Path | None = option(
        None, "Save the scores, so that the command can continue after a stop.", metavar="FILE"
    ),
    as_json: bool = json_option(),
) -> None:
    """Test an agent in the worlds of a suite: what is fixed, what regressed, what fails newly?

    Exit codes: 0 passed, 1 failed, 2 invalid input, 3 inconclusive.
    """
    with errors_as_sentences():
        from sada_gym.analyses.regression.junit import junit as as_junit
        from sada_gym.analyses.regression.junit import markdown as as_markdown
        from sada_gym.analyses.regression.regress import regress as test
        from sada_gym.foundations.files import write_file

        with scores_progress(kept=store is not None) as progress:
            result = test(
                suite,
                agent,
                baseline=baseline,
                margin=margin,
                max_failing=max_failing,
                require_fixed=require_fixed,
                max_probability=max_probability,
                budget=budget,
                workers=workers,
                store=store,
                on_scores=progress,
            )
        if junit is not None:
            write_file(junit, as_junit(result))
        if markdown is not None:
            write_file(markdown, as_markdown(result))
    if as_json:
        print_json(result)
        raise typer.Exit(result.exit_code)
    say(f"{result.agent} on {result.track}, compared with {result.compared_with}", lead="[bold]")
    say("  suite  ordinary", lead="[dim]")
    ordinary = result.counts(ordinary=True)
    for change, count in result.counts().items():
        usual = ordinary.get(change, 0)
        say(f"  {count - usual:>5}  {usual:>8}  {change}")
    if result.failing is not None:
        say(f"The worlds that fail: {result.failing}.")
    for difference in result.differences:
        say(f"Different from the export: {difference}.", lead="[dim]")
    say(f"{result.decision.status.capitalize()}. {result.decision.reason}")
    raise typer.Exit(result.exit_code)
