"""The command line: `sada-gym`."""

from __future__ import annotations

import typer

from sada_gym.cli.attack import attack
from sada_gym.cli.benchmark import ListingCommand, benchmark
from sada_gym.cli.catalogue import adversaries, agents, envs
from sada_gym.cli.check import check
from sada_gym.cli.console import SpreadingCommand, debugging
from sada_gym.cli.merge import merge

app = typer.Typer(
    name="sada-gym",
    help="Find out how trained agents fail: attack them with worlds built from semantic "
    "parameters, and measure how often that fools them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def _main(
    debug: bool = typer.Option(
        False, "--debug", help="Show the traceback of an error, not only its text."
    ),
) -> None:
    debugging(debug)


app.command()(envs)
app.command()(agents)
app.command()(adversaries)
app.command(cls=SpreadingCommand)(attack)
app.command(cls=SpreadingCommand)(check)
app.command(cls=ListingCommand)(benchmark)
app.command(cls=ListingCommand)(merge)


def main() -> None:
    """Run the command line."""
    app(prog_name="sada-gym")
