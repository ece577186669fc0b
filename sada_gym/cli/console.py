"""What the commands share: the two consoles, k=v options, and errors told in one sentence."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperCommand

from sada_gym.errors import BudgetExhausted, UserError, WorkerError

out = Console()
err = Console(stderr=True)

_SPREADING = ("--set", "--env-kwargs")
_debug = False


def debugging(on: bool) -> None:
    """Let errors keep their tracebacks, or not."""
    global _debug
    _debug = on


@contextmanager
def told_in_a_sentence() -> Iterator[None]:
    """Turn bad input into one sentence and exit code 2, a lost worker into exit code 1.

    Any other exception is a bug and keeps its traceback.
    """
    try:
        yield
    except (ValueError, TypeError, ImportError, OSError, BudgetExhausted, WorkerError) as error:
        if _debug:
            raise
        err.print(f"[bold red]Error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        raise typer.Exit(1 if isinstance(error, WorkerError) else 2) from error


def key_values(pairs: Sequence[str], option: str) -> dict[str, Any]:
    """Parse `k=v` pairs; a value is JSON where it parses as such, else a string.

    Raises:
        ValueError: If a pair has no key or no `=`, or a key stands twice.
    """
    parsed: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not key or not equals:
            raise UserError(f"Expected {option} key=value, got {pair!r}.")
        if key in parsed:
            raise UserError(f"Expected each key of {option} once, got {key!r} twice.")
        try:
            parsed[key] = json.loads(text)
        except ValueError:
            parsed[key] = text
    return parsed


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # what a container or a queue grants, not what there is
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class SpreadingCommand(TyperCommand):
    """A command that takes `--set a=1 b=2` for `--set a=1 --set b=2`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option before each further pair."""
        return super().parse_args(ctx, list(_spread(args)))


def _spread(args: Sequence[str]) -> Iterator[str]:
    return spread(args, _SPREADING, lambda arg: "=" in arg)


def spread(
    args: Sequence[str], options: Sequence[str], belongs: Callable[[str], bool]
) -> Iterator[str]:
    """Repeat an option before each further value of it.

    Args:
        args: The command line.
        options: Those that take several values.
        belongs: Whether a word that is no option is such a value.
    """
    current: str | None = None
    fresh = False
    for arg in args:
        if arg in options:
            current, fresh = arg, True
        elif current and not fresh and belongs(arg) and not arg.startswith("-"):
            yield current
        else:
            current = current if fresh and not arg.startswith("-") else None
            fresh = False
        yield arg
