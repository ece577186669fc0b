"""An `ImageApplication` in a TOML file: its keys are the arguments of the class."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sada_gym.agents.agent_files import ONNX, TORCHSCRIPT
from sada_gym.envs.images.application import ImageApplication
from sada_gym.envs.wrapped.toml import argument_keys, check_types, imported
from sada_gym.errors import UserError, check_known
from sada_gym.foundations.cards import fetchable


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
    keys, _ = argument_keys(
        ImageApplication,
        images=str | list[str],
        agent=str,
        labels=str | bool | list[int],
        conditions=str | list[str] | dict[str, Any],
    )
    check_known(f"key in {path}", table, [*keys])
    if agent is None and "agent" not in table:
        raise UserError(f"Expected the key 'agent' in {path}, got none. Add it to the file.")
    check_types(table, keys, path)
    arguments = dict(table)
    images = arguments.pop("images")
    listed = [_beside(path, each) for each in ([images] if isinstance(images, str) else images)]
    if isinstance(arguments.get("labels"), str):
        arguments["labels"] = _beside(path, arguments["labels"])
    given = agent if agent is not None else agent_of(arguments["agent"], path)
    arguments["agent"] = given
    return ImageApplication(listed[0] if isinstance(images, str) else listed, **arguments)


def agent_of(text: str, path: Path) -> Any:
    """Return the agent that a file names: a name, a file, or the imported `module:object`."""
    if text in fetchable() or text.startswith("torchvision:"):
        return text
    if Path(text).suffix.lower() in (*ONNX, *TORCHSCRIPT) or ":" not in text:
        return _beside(path, text)
    return imported(text, path, "agent", "a model's file, a name or module:object")


def _beside(path: Path, text: str) -> Path:
    return path.parent / os.path.expanduser(text)
