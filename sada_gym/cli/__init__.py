"""The command line: `sada-gym`."""

from __future__ import annotations

import typer

from sada_gym import __version__
from sada_gym.cli.attack import attack
from sada_gym.cli.benchmark import benchmark
from sada_gym.cli.catalogue import adversaries, agents, envs
from sada_gym.cli.check import check
from sada_gym.cli.console import set_debug
from sada_gym.cli.replay import replay
from sada_gym.cli.submit import submit

app = typer.Typer(
    name="sada-gym",
    help="Find out how trained agents fail: attack them with worlds built from semantic "
    "parameters, and measure how often that fools them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # plain text, which keeps its words whole in narrow terminals and in pipes
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

# words without an option reach the command, which says what to write instead
_STRAY = {"allow_extra_args": True}


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
    set_debug(debug)


app.command()(envs)
app.command()(agents)
app.command()(adversaries)
app.command(context_settings=_STRAY)(attack)
app.command(context_settings=_STRAY)(check)
app.command(context_settings=_STRAY)(benchmark)
app.command()(replay)
app.command()(submit)


def main() -> None:
    """Run the command line."""
    app(prog_name="sada-gym")
