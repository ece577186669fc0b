"""The command line: `sada-gym`."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from sada_gym import __version__
from sada_gym.cli.terminal import prepare
from sada_gym.foundations.lazy import load

# a word without an option reaches the command, which says what to write instead
_STRAY = {"allow_extra_args": True}

_COMMANDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "envs": ("catalogue:envs", "List the environments, or show one.", {}),
    "agents": ("catalogue:agents", "List the trained agents.", {}),
    "adversaries": ("catalogue:adversaries", "List the adversaries and their options.", {}),
    "fetch": ("fetch:fetch", "Fetch a third-party agent.", {}),
    "init": ("init:init", "Write a TOML file for attacking your own agent.", _STRAY),
    "attack": ("attack:attack", "Find out how often an agent fails, and where.", _STRAY),
    "diagnose": ("diagnose:diagnose", "Say where an agent fails, in a few rules.", {}),
    "estimate": ("estimate:estimate", "Say how likely an agent fails in ordinary use.", {}),
    "report": ("report:report", "Write a page about a run, or compare two runs.", {}),
    "replay": ("replay:replay", "Make a video of how an agent fails.", {}),
    "transfer": ("transfer:transfer", "Score a run's samples in other worlds.", {}),
    "confirm": (
        "confirm:confirm",
        "Try failures again: fresh seeds or truer worlds.",
        {},
    ),
    "export": ("export:export", "Write a run's failures as a test suite.", {}),
    "regress": ("regress:regress", "Test another agent with such a suite.", {}),
    "check": ("check:check", "Check your own environment.", _STRAY),
    "benchmark": ("benchmark:benchmark", "Compare adversaries.", _STRAY),
    "submit": ("submit:submit", "Make an entry for the leaderboard.", {}),
}
"""The commands: the function of each, its line in the list, and its context settings."""


class _LazyGroup(TyperGroup):
    """Imports a command when it is called: help and a misspelt command need none of them."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, stub, rest = super().resolve_command(ctx, args)
        return name, None if stub is None else _load(args[0]), rest


app = typer.Typer(
    name="sada-gym",
    cls=_LazyGroup,
    help="Find out how trained agents fail: attack them with worlds built from semantic "
    "parameters, and measure how often that fools them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # plain text, which keeps its words whole in narrow terminals and in pipes
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _load(name: str) -> Any:
    path, _, settings = _COMMANDS[name]
    command = load(f"sada_gym.cli.{path}")
    for given in inspect.signature(command).parameters.values():
        if "Path" in str(given.annotation):
            given.default.parser = _path
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(name, context_settings=settings)(command)
    return typer.main.get_command(alone)


def _path(text: str) -> Path:
    if not text:  # which pathlib takes for the working directory
        raise typer.BadParameter("Expected a path, got ''. Name one, or . for this folder.")
    return Path(text)


def _stub() -> None:
    """Stand for a command until it is called."""


for _name, _row in _COMMANDS.items():
    app.command(_name, help=_row[1])(_stub)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sada-gym {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    debug: bool = typer.Option(
        False, "--debug", help="Show the traceback of an error, not only its text."
    ),
    version: bool = typer.Option(  # noqa: ARG001 - the callback shows it
        False, "--version", help="Show the version and exit.", callback=_show_version, is_eager=True
    ),
) -> None:
    from sada_gym.cli.console import set_debug

    set_debug(debug)


def main() -> None:
    """Run the command line."""
    try:
        prepare()
    except FileNotFoundError:
        typer.echo(
            "Error: Expected a working directory, got one that was deleted. "
            "Change to another: cd ~",
            err=True,
        )
        raise SystemExit(2) from None
    app(prog_name="sada-gym")
