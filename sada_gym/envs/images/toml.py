"""An `ImageApplication` in a TOML file: its keys are the arguments of the class."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sada_gym.agents.agent_files import names_model
from sada_gym.envs.images.application import ImageApplication
from sada_gym.envs.wrapped import toml


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
    keys = toml.argument_keys(
        ImageApplication,
        images=texts,
        agent=texts,
        labels=str | bool | list[int],
        conditions=str | list[str] | dict[str, Any],
    )
    arguments = toml.checked_table(table, path, *keys, agent)
    images = arguments["images"]
    is_one = isinstance(images, str)
    arguments["images"] = (
        _beside(path, images) if is_one else [_beside(path, each) for each in images]
    )
    if isinstance(arguments.get("labels"), str):
        arguments["labels"] = _beside(path, arguments["labels"])
    arguments["agent"] = agent if agent is not None else agent_of(arguments["agent"], path)
    return ImageApplication(**arguments)


def agent_of(text: str | list[Any], path: Path) -> Any:
    """Return the agent that a file names: a name, a file, a process, or the imported object."""
    return text if isinstance(text, str) and names_model(text) else toml.agent_of(text, path)


def _beside(path: Path, text: str) -> Path:
    return path.parent / os.path.expanduser(text)
