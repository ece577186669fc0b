"""Files that are written whole or not at all, and records in JSON that are checked when read."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from sada_gym.errors import UserError


class Strict(BaseModel):
    """Frozen, and no field that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid")


Model = TypeVar("Model", bound=Strict)


def write_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: beside it first, then in one rename."""
    beside = path.with_name(f".{path.name}.tmp")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def write_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Fill a folder and put it in place whole, instead of one that an earlier run left."""
    beside = path.with_name(f".{path.name}.tmp")
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir()
    fill(beside)
    if path.exists():
        shutil.rmtree(path)
    beside.rename(path)


def write_model(path: Path, model: Strict) -> None:
    """Write a model as JSON."""
    text = json.dumps(model.model_dump(mode="json", by_alias=True), indent=2, allow_nan=False)
    write_file(path, f"{text}\n".encode())


def read_model(path: Path, kind: type[Model]) -> Model:
    """Read a model that `write_model` wrote.

    Raises:
        ValueError: If the file is missing or is not such a model.
    """
    try:
        return kind.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise UserError(f"Expected {path}, got no such file. Name an attack's folder.") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise UserError(
            f"Expected {path} as an attack writes it, got a different one "
            f"({where}: {first['msg']}). Restore it, or start anew in another folder."
        ) from error
