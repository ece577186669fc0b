"""An `ImageApplication` in a TOML file: its keys are the arguments of the class."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sada_gym.agents.agent_files import names_model
from sada_gym.envs.images.application import ImageApplication
from sada_gym.envs.wrapped import toml
from sada_gym.errors import UserError, check_known


def images_of(table: Mapping[str, Any], path: Path, agent: Any = None) -> ImageApplication:
    """Make the application that the table of a TOML file describes.

    Args:
        table: Its keys; paths are relative to the folder of the file.
        path: The file, which need not exist.
        agent: What takes the place of the file's agent.

    Raises:
        UserError: If a key is unknown or missing, a value has the wrong type, or the application
            raises it.
    """
    texts = str | list[str]
    keys, _ = toml.argument_keys(
        ImageApplication,
        images=texts,
        agent=texts,
        labels=str | bool | list[int],
        conditions=str | list[str] | dict[str, Any],
    )
    check_known(f"key in {path}", table, [*keys])
    if agent is None and "agent" not in table:
        raise UserError(f"Expected the key 'agent' in {path}, got none. Add it to the file.")
    toml.check_types(table, keys, path)
    arguments = dict(table)
    images = arguments.pop("images")
    listed = [_beside(path, each) for each in ([images] if isinstance(images, str) else images)]
    if isinstance(arguments.get("labels"), str):
        arguments["labels"] = _beside(path, arguments["labels"])
    given = agent if agent is not None else agent_of(arguments["agent"], path)
    arguments["agent"] = given
    return ImageApplication(listed[0] if isinstance(images, str) else listed, **arguments)


def agent_of(text: str | list[Any], path: Path) -> Any:
    """Return the agent that a file names: a name, a file, a process, or the imported object."""
    return text if isinstance(text, str) and names_model(text) else toml.agent_of(text, path)


def _beside(path: Path, text: str) -> Path:
    return path.parent / os.path.expanduser(text)
