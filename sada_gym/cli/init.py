"""`sada-gym init`: writes a first TOML file with which an agent can be attacked at once."""

from __future__ import annotations

import shlex
from pathlib import Path

import typer

from sada_gym.cli.console import (
    check_no_stray_words,
    env_kwargs_option,
    err,
    errors_as_sentences,
    json_option,
    key_values,
    option,
    out,
    print_json,
    say,
)
from sada_gym.errors import UserError, check_known


def init(
    context: typer.Context,
    env_id: str = typer.Argument(
        metavar="ID", help="A Gymnasium environment's id; `module:ID` imports the module first."
    ),
    agent: str | None = option(
        None,
        "The agent: its file, module:object or tcp://...; without one, a stand-in is trained.",
        metavar="FILE|module:object",
    ),
    env_kwargs: list[str] | None = env_kwargs_option(),
    max_steps: int | None = option(
        None, "The limit of steps of an episode.", minimum=1, shown="the environment's own"
    ),
    steps: int = option(20_000, "Training steps of a stand-in.", minimum=1),
    file: Path | None = option(
        None, "The TOML file to write.", "--out", metavar="FILE", shown="ENVIRONMENT.toml"
    ),
    as_json: bool = json_option(),
) -> None:
    """Write a TOML file for an attack on an agent in any Gymnasium environment.

    It looks at the environment, tries out what can be changed in it, and guesses ranges, a score
    and a threshold from twenty episodes. Then `sada-gym attack FILE` works with nothing edited.
    """
    with errors_as_sentences():
        check_no_stray_words(context.args, "--env-kwargs a=1 --env-kwargs b=2")
        keywords = key_values(env_kwargs, "--env-kwargs")
        from sada_gym.envs.wrapped.starter import starter_file, train_stand_in
        from sada_gym.envs.wrapped.toml import find_modules_in
        from sada_gym.foundations.files import write_file
        from sada_gym.foundations.registration import env_ids

        if env_id in env_ids():
            raise UserError(
                f"Expected an environment of your own, got {env_id}, which is ready to attack: "
                f"sada-gym attack {env_id}"
            )
        file = file or Path(f"{env_id.rpartition(':')[2].replace('/', '-')}.toml")
        check_known("file's ending", [file.suffix.lower()], [".toml"])
        if file.exists():
            raise UserError(f"Expected a new file, got {file}. Remove it, or name another: --out.")
        find_modules_in(file.parent)
        if agent is None:
            zipped = file.with_suffix(".zip")
            agent = str(zipped)
            if zipped.exists():
                say(f"{zipped} is there already and is taken as the agent.", console=err)
            else:
                say(f"No --agent: a stand-in learns for {steps:,} steps.", console=err)
                train_stand_in(env_id, zipped, steps, env_kwargs=keywords, max_steps=max_steps)
        starter = starter_file(
            env_id, agent, env_kwargs=keywords, max_steps=max_steps, folder=file.parent
        )
        write_file(file, starter.text)
    if as_json:
        print_json({"file": str(file), "text": starter.text, "notes": starter.notes})
        return
    out.print(starter.text, markup=False, highlight=False, soft_wrap=True)
    for note in starter.notes:
        say(note)
    say(f"Written to {file}. All of it is a guess: look it over.")
    if starter.ready:
        say(f"Then: {shlex.join(['sada-gym', 'attack', str(file)])}")
