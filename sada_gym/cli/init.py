"""`sada-gym init`: writes a first TOML file with which an agent can be attacked at once."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

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
    env_id: str | None = typer.Argument(
        None,
        metavar="ID",
        help="A Gymnasium environment's id; `module:ID` imports the module first.",
    ),
    agent: str | None = option(
        None,
        "The agent: its file, module:object or tcp://...; without one, a stand-in is trained.",
        metavar="FILE|module:object",
    ),
    images: Path | None = option(
        None, "A folder of images instead of an environment.", metavar="FOLDER"
    ),
    labels: Path | None = option(
        None, "The labels of the images: COCO's JSON, or a folder of YOLO files.", metavar="PATH"
    ),
    task: str | None = option(None, "What the model does: classify or detect.", metavar="TASK"),
    env_kwargs: list[str] | None = env_kwargs_option(),
    max_steps: int | None = option(
        None, "The most steps of an episode.", minimum=1, shown="the environment's own"
    ),
    steps: int = option(20_000, "Training steps of a stand-in.", minimum=1),
    file: Path | None = option(
        None, "The TOML file to write.", "--out", metavar="FILE", shown="ENVIRONMENT.toml"
    ),
    as_json: bool = json_option(),
) -> None:
    """Write a TOML file for attacking an agent in any Gymnasium environment, or on images.

    It inspects the environment, tries out what can be changed in it, and guesses ranges, a score
    and a threshold from twenty episodes. Then `sada-gym attack FILE` works without edits. With
    --images it writes a file for a classifier or a detector on your images.
    """
    with errors_as_sentences():
        check_no_stray_words(context.args, "--env-kwargs a=1 --env-kwargs b=2")
        keywords = key_values(env_kwargs, "--env-kwargs")
        from sada_gym.envs.wrapped.starter import starter_file
        from sada_gym.envs.wrapped.toml import find_modules_in
        from sada_gym.foundations.files import write_file
        from sada_gym.foundations.registration import env_ids

        if (env_id is None) == (images is None):
            got = "none" if env_id is None else "both"
            raise UserError(f"Expected an environment's ID or --images FOLDER, got {got}.")
        if env_id in env_ids():
            raise UserError(
                f"Expected your own environment, got {env_id}, which is ready to attack: "
                f"sada-gym attack {env_id}"
            )
        name = env_id or f"{images and images.resolve().name}"
        file = file or Path(f"{name.rpartition(':')[2].replace('/', '-')}.toml")
        check_known("file's ending", [file.suffix.lower()], [".toml"])
        if file.exists():
            raise UserError(f"Expected a new file, got {file}. Remove it, or name another: --out.")
        find_modules_in(file.parent)
        if env_id is None:
            if agent is None:
                raise UserError("Expected the model by --agent with --images, got none.")
            from sada_gym.envs.images.starter import images_file

            starter = images_file(images, agent, labels, task, file)
        else:
            if agent is None:
                agent = _stand_in(env_id, file, steps, keywords, max_steps)
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
    say(f"Written to {file}. All of it is a guess: check it.")
    if starter.ready:
        say(f"Then: {shlex.join(['sada-gym', 'attack', str(file)])}")


def _stand_in(
    env_id: str, file: Path, steps: int, keywords: dict[str, Any], max_steps: int | None
) -> str:
    """Train an agent beside a file, unless it is there, and return its file."""
    from sada_gym.envs.wrapped.starter import train_stand_in

    zipped = file.with_suffix(".zip")
    if zipped.exists():
        say(f"{zipped} exists already and is used as the agent.", console=err)
    else:
        say(f"No --agent: a stand-in learns for {steps:,} steps.", console=err)
        train_stand_in(env_id, zipped, steps, env_kwargs=keywords, max_steps=max_steps)
    return str(zipped)
