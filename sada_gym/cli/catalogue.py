"""`sada-gym envs | agents | adversaries`: what there is."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from sada_gym.cli.console import key_values, out, told_in_a_sentence


def envs(
    env_id: Annotated[
        str | None, typer.Argument(metavar="[ID]", help="Show this one's parameters.")
    ] = None,
    env_kwargs: Annotated[
        list[str] | None,
        typer.Option(metavar="k=v", help="A keyword of the environment; repeatable."),
    ] = None,
) -> None:
    """List the environments, or show one's parameters, units and fooling threshold."""
    with told_in_a_sentence():
        if env_id is not None:
            _show(env_id, env_kwargs or [])
            return
        from sada_gym.registration import TABLE

        table = _table("id", "keywords it fixes", "leaderboard")
        for row in TABLE:
            fixed = ", ".join(f"{k}={v}" for k, v in row.kwargs.items())
            table.add_row(row.id, fixed, "track" if row.kwargs else "")
        out.print(table)
        out.print("[dim]One in detail: sada-gym envs ID[/]", highlight=False)


def _show(env_id: str, pairs: list[str]) -> None:
    from sada_gym.registration import make_application

    application = make_application(env_id, **key_values(pairs, "--env-kwargs"))
    table = _table("parameter", "low", "high", "unit or choices")
    for parameter in application.parameters.parameters:
        table.add_row(
            parameter.name,
            f"{parameter.low:g}",
            f"{parameter.high:g}",
            parameter.unit or ", ".join(parameter.choices) or "-",
        )
    out.print(table)
    out.print(
        f"{env_id}: fooled where Q <= {application.fooling_threshold:g}; "
        f"{application.sample_size} test samples",
        highlight=False,
    )
    application.close()


def agents() -> None:
    """List the trained agents that are shipped."""
    from sada_gym.agents import AGENTS

    table = _table("agent", "for", "what it is")
    for agent in AGENTS:
        table.add_row(agent.name, agent.application, agent.summary)
    out.print(table)


def adversaries() -> None:
    """List the adversaries, with their options and defaults."""
    with told_in_a_sentence():
        from sada_gym import adversaries as registry

        table = _table("adversary", "what it does", "presets", "options (--set)")
        for row in registry.describe():
            options = "\n".join(f"{name}={value}" for name, value in row.options.items())
            table.add_row(row.name, row.summary, ", ".join(row.presets), escape(options))
        out.print(table)


def _table(*columns: str) -> Table:
    table = Table(header_style="bold", show_lines=False)
    for column in columns:
        table.add_column(column)
    return table
