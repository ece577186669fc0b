"""`sada-gym check`: says whether an application keeps the contract, ours or a user's own."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING

import typer
from rich.markup import escape
from rich.status import Status

from sada_gym.cli.console import (
    check_no_stray_words,
    env_kwargs_option,
    err,
    errors_as_sentences,
    json_option,
    key_values,
    make_table,
    out,
    print_json,
    say,
    stop_code,
    stoppable,
)
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from sada_gym.testing.check import Check


def check(
    context: typer.Context,
    subject: str = typer.Argument(
        metavar="ID|FILE.toml|FILE.py",
        help="An environment's id, a file that describes one, or one with applications.",
    ),
    env_kwargs: list[str] | None = env_kwargs_option(),
    as_json: bool = json_option(),
) -> None:
    """Check an application against the contract: scores, seeds, purity, Gymnasium.

    FILE.py is imported, so name only a file that you trust. All applications at its top level are
    checked, and one of each class that needs no arguments. The exit code is 1 if a check fails.
    """
    found: Sequence[Check] = ()
    status = Status("Opening", console=err)

    def show(name: str, checks: Sequence[Check]) -> None:
        nonlocal found
        found = checks
        status.update(f"Checking {name}; {len(checks)} checks are done")

    with errors_as_sentences():
        check_no_stray_words(context.args, "--env-kwargs a=1 --env-kwargs b=2")
        from sada_gym.testing.check import check_environment, check_file

        try:
            with stoppable(), status if err.is_terminal else nullcontext():
                if subject.endswith(".py"):
                    if env_kwargs:
                        raise UserError("Expected --env-kwargs only with an environment's id.")
                    reports = check_file(subject, on_check=show)
                else:
                    given = key_values(env_kwargs, "--env-kwargs")
                    reports = check_environment(subject, on_check=show, **given)
        except KeyboardInterrupt as stop:
            say("\nStopped. What was found so far:", console=err)
            _print_table(f"{subject} (stopped)", found)
            raise typer.Exit(stop_code(stop)) from None
    if as_json:
        parts = ("subject", "passed", "checks")
        print_json([{part: getattr(report, part) for part in parts} for report in reports])
    for report in () if as_json else reports:
        _print_table(report.subject, report.checks)
    if not all(report.passed for report in reports):
        raise typer.Exit(1)


def _print_table(subject: str, checks: Sequence[Check]) -> None:
    table = make_table("", "check", "finding", title=escape(subject))
    for item in checks:
        mark = "[green]ok[/]" if item.passed else "[bold red]fails[/]"
        table.add_row(mark, escape(item.name), escape(item.sentence))
    out.print(table)
