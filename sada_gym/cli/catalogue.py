"""`sada-gym envs | agents | adversaries`: lists of what the package has."""

from __future__ import annotations

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from sada_gym.cli.console import (
    env_kwargs_option,
    errors_as_sentences,
    json_option,
    key_values,
    out,
    print_json,
    say,
    wrapped,
)


def envs(
    env_id: str | None = typer.Argument(
        None, metavar="[ID|FILE.toml]", help="The environment whose parameters to show."
    ),
    env_kwargs: list[str] | None = env_kwargs_option(),
    as_json: bool = json_option(),
) -> None:
    """List the environments, or show one's parameters, units and fooling threshold."""
    with errors_as_sentences():
        if env_id is not None:
            _show_environment(env_id, env_kwargs, as_json)
            return
        from sada_gym.foundations.cards import cards
        from sada_gym.foundations.registration import ids_of

        if as_json:
            missing = {card.name: card.missing for card in cards() if card.missing}
            print_json(
                [
                    {"id": known_id, "keywords": keywords, "missing": missing.get(card, "")}
                    for card, known in ((card.name, ids_of(card.name)) for card in cards())
                    for known_id, keywords in known.items()
                ]
            )
            return
        table = _table("id", "keywords it fixes")
        for known_id, keywords in ids_of().items():
            table.add_row(known_id, ", ".join(f"{k}={v}" for k, v in keywords.items()))
        out.print(table)
        for card in cards():
            if card.missing:
                say(f"{card.name}: {card.missing}", lead="[dim]")
        say("An id that fixes a keyword is a track of the leaderboard.", lead="[dim]")
        say("To see one in detail: sada-gym envs ID", lead="[dim]")


def _show_environment(env_id: str, pairs: list[str] | None, as_json: bool) -> None:
    from sada_gym.evaluation.problems import make_application
    from sada_gym.experiment.names import default_note

    keywords = key_values(pairs, "--env-kwargs")
    application = make_application(env_id, **keywords)
    if as_json:
        print_json(
            {
                "id": env_id,
                "fooling_threshold": application.fooling_threshold,
                "samples": application.sample_size,
                "parameters": application.parameters.parameters,
            }
        )
        application.close()
        return
    table = _table("parameter", "low", "high", "unit or choices")
    for parameter in application.parameters.parameters:
        shape = ["(logarithmic)"] if parameter.log else []
        table.add_row(
            parameter.name,
            "-" if parameter.choices else f"{parameter.low:g}",
            "-" if parameter.choices else f"{parameter.high:g}",
            Text(" ".join([", ".join(parameter.choices), parameter.unit, *shape]).strip() or "-"),
        )
    out.print(table)
    threshold, samples = application.fooling_threshold, application.sample_size
    if (note := default_note(env_id, keywords)) is not None:
        say(note)
    say(f"{env_id}: fooled where Q <= {threshold:g}; {samples} test samples")
    application.close()


def agents(as_json: bool = json_option()) -> None:
    """List the trained agents: shipped, in third-party packages, or to be fetched."""
    from sada_gym.foundations.cards import PackagedAgent, cards

    if as_json:
        print_json(
            [
                {
                    "name": agent.name,
                    "for": card.name,
                    "summary": agent.summary,
                    "fetch": agent in card.fetched,
                    "package": f"{agent.package} {agent.version}"
                    if isinstance(agent, PackagedAgent)
                    else None,
                }
                for card in cards()
                for agent in card.all_agents
            ]
        )
        return
    table = _table("agent", "for", "what it is")
    for card in cards():
        for packaged in card.packaged:
            source = f"{packaged.package} {packaged.version}"
            table.add_row(packaged.name, card.name, f"{packaged.summary} ({source})")
        for agent in card.agents:
            table.add_row(agent.name, card.name, agent.summary)
        for other in card.fetched:
            table.add_row(other.name, card.name, f"{other.summary} (sada-gym fetch {other.name})")
    out.print(table)


def adversaries(as_json: bool = json_option()) -> None:
    """List the adversaries, with their options and defaults."""
    with errors_as_sentences():
        from sada_gym import adversaries as registry

        rows = registry.describe()
        if as_json:
            print_json(rows)
            return
        for row in rows:
            say(row.name, lead="[bold]")
            lines = [row.summary]
            if row.presets:
                lines.append(f"Presets (--preset): {', '.join(row.presets)}")
            if row.options:
                options = "  ".join(f"{name}={value}" for name, value in row.options.items())
                lines.append(f"Options (--set): {options}")
            for line in lines:
                say(wrapped(line, 2))


def _table(*columns: str) -> Table:
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        # names and ids stay whole: they are there to be copied
        table.add_column(column, no_wrap=column == columns[0])
    return table
