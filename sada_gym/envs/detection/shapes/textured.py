"""Textured models that others made, out of Debian's packages, as a checked list names them."""

from __future__ import annotations

import functools
import os
import zipfile
from pathlib import Path
from typing import Literal

from sada_gym.envs.detection.shapes.ac3d import read_ac3d
from sada_gym.envs.detection.shapes.assembly import assemble_textured
from sada_gym.envs.detection.shapes.cad import Direction, Orientation
from sada_gym.envs.detection.shapes.companions import Companions
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.detection.shapes.obj import read_obj
from sada_gym.envs.detection.shapes.triangles import as_text
from sada_gym.errors import FileError, MissingPart, UserError
from sada_gym.foundations.files import Strict, read_toml

LIST = Path(__file__).with_name("textured.toml")
"""Which models are used, and what their files have to hold."""

FOLDER_VARIABLE = "SADA_GYM_MODELS"
"""Names a folder that holds the files, in the place of `FOLDERS`."""

FOLDERS = {
    "sweethome3d": Path("/usr/share/sweethome3d/furniture"),
    "flightgear": Path("/usr/share/games/flightgear"),
}
"""Where Debian's packages put the files of each set."""

_PACKAGES = {
    "sweethome3d": "sweethome3d-furniture",
    "flightgear": "flightgear-data-ai flightgear-data-models",
}


class _Model(Strict):
    """One model of the list; its path is relative to the set's folder, or in an archive there."""

    set: Literal["sweethome3d", "flightgear"]
    archive: str | None = None
    member: str
    object_class: str
    name: str
    up: Direction = "+y"
    front: Direction | None = None
    paint: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    textures: str | None = None
    author: str
    licence: str
    sha256: str

    @property
    def orientation(self) -> Orientation:
        front: Direction = "+z" if self.archive else "-x"
        return Orientation(up=self.up, front=self.front or front)


class _ModelList(Strict):
    model: tuple[_Model, ...]


@functools.cache
def listed_models() -> tuple[_Model, ...]:
    """Read the list of models."""
    return _ModelList.model_validate(read_toml(LIST)).model


def sweethome3d(object_class: str) -> tuple[Shape, ...]:
    """Load the models of a class from the package sweethome3d-furniture; see `textured`."""
    return _load(object_class, ("sweethome3d",), os.environ.get(FOLDER_VARIABLE))


def flightgear(object_class: str) -> tuple[Shape, ...]:
    """Load the models of a class from FlightGear's data packages; see `textured`."""
    return _load(object_class, ("flightgear",), os.environ.get(FOLDER_VARIABLE))


def textured(object_class: str) -> tuple[Shape, ...]:
    """Load the textured models of a class, once a process; their authors stand in `LIST`.

    Raises:
        UserError: If there are none of the class.
        FileError: If a file is missing, or is another one than the list says.
    """
    return _load(object_class, tuple(FOLDERS), os.environ.get(FOLDER_VARIABLE))


@functools.cache
def _load(object_class: str, sets: tuple[str, ...], folder: str | None) -> tuple[Shape, ...]:
    known = [model for model in listed_models() if model.set in sets]
    models = [model for model in known if model.object_class == object_class]
    if not models:
        classes = sorted({model.object_class for model in known})
        raise UserError(
            f"Expected object_class to be one of {', '.join(classes)} for the models of "
            f"{' and '.join(sets)}, got {object_class!r}; choose one of these."
        )
    return tuple(_shape(model, folder) for model in models)


@functools.cache
def _shape(model: _Model, folder: str | None) -> Shape:
    if model.archive is None:
        path = _find(model, model.member, folder)
        root = path.parents[len(Path(model.member).parts) - 1]
        return _read(model, path, Companions.in_folder(root, model.member, model.textures))
    path = _find(model, model.archive, folder)
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(model, path, Companions.in_archive(archive, model.member))
    except (zipfile.BadZipFile, OSError) as error:
        raise FileError(f"Expected a ZIP in {path}, got {error}. {_fixing(model)}") from error


def check_installed() -> None:
    """Raise a FileError that says what to install if a file of any set is missing."""
    for model in listed_models():
        _find(model, model.archive or model.member, os.environ.get(FOLDER_VARIABLE))


def _find(model: _Model, file: str, folder: str | None) -> Path:
    """Find a file of a model; raise `FileError` with the line that installs it."""
    # a folder that is given may hold the files of one set, or a folder for each
    roots = [FOLDERS[model.set]] if folder is None else [Path(folder), Path(folder) / model.set]
    for root in roots:
        if (root / file).is_file():
            return root / file
    raise MissingPart(
        f"Expected {file} in {' or '.join(map(str, roots))} for the models of {model.set}, got no "
        f"such file. {_fixing(model)}"
    )


def _fixing(model: _Model) -> str:
    return (
        f"Install it by `sudo apt install {_PACKAGES[model.set]}`, or set {FOLDER_VARIABLE} to "
        "the folder that holds it."
    )


def _read(model: _Model, path: Path, companions: Companions) -> Shape:
    name = f"{model.set}/{model.name}"
    try:
        text = as_text(companions.own())
        if model.archive is None:
            mesh = read_ac3d(text, companions, model.hidden)
        else:
            mesh = read_obj(text, companions)
        found = companions.sha256.hexdigest()
        if found != model.sha256:
            raise UserError(f"files with SHA-256 {found[:12]}..., not {model.sha256[:12]}...")
        rotation = model.orientation.rotation()
        return assemble_textured(name, model.object_class, mesh, rotation, model.paint)
    except UserError as error:
        raise FileError(
            f"Expected {model.member} in {path} as Debian 12 has it, got {error}. {_fixing(model)}"
        ) from error
