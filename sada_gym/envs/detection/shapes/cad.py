"""A user's own CAD files in place of the procedural shapes: a folder of meshes a class.

A file names others only where its textures are wanted.
"""

from __future__ import annotations

import codecs
import hashlib
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from typing_extensions import Self

from sada_gym.envs.detection.shapes.assembly import Part, assemble, assemble_textured
from sada_gym.envs.detection.shapes.companions import MAX_BYTES, Companions
from sada_gym.envs.detection.shapes.gltf import read_gltf
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.detection.shapes.obj import read_obj
from sada_gym.envs.detection.shapes.ply import read_ply
from sada_gym.envs.detection.shapes.stl import read_stl
from sada_gym.envs.detection.shapes.surface import Surface
from sada_gym.envs.detection.shapes.triangles import Triangles, as_text, check_count, wound
from sada_gym.errors import UserError

Direction = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class Orientation(BaseModel):
    """The files' axes that point up and where an object looks, ShapeNet's by default."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    up: Direction = "+y"
    front: Direction = "-z"

    @model_validator(mode="after")
    def _is_plane(self) -> Self:
        if self.up[1] == self.front[1]:
            raise UserError(
                f"Expected up and front along two different axes, got {self.up} and {self.front}; "
                "ShapeNet's are +y and -z"
            )
        return self

    def rotation(self) -> npt.NDArray[np.float64]:
        """Return the matrix (3, 3) from the files' axes to front +x, left +y, up +z."""
        up, front = _vector(self.up), _vector(self.front)
        return np.stack([front, np.cross(up, front), up])


class FolderSettings(Orientation):
    """What `shapes.json` says of a folder's files.

    Attributes:
        textures: Whether the files' materials and textures are drawn, not the paint alone.
        paint: Patterns of names of materials, such as `body*`, that take the paint all the same.
    """

    textures: bool = False
    paint: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _has_materials(self) -> Self:
        if self.paint and not self.textures:
            raise UserError(
                'Expected "textures": true beside "paint", got none; without textures, all faces '
                "are painted"
            )
        return self


def _vector(direction: str) -> npt.NDArray[np.float64]:
    vector = np.zeros(3)
    vector["xyz".index(direction[1])] = 1.0 if direction[0] == "+" else -1.0
    return vector


_COMPANIONS = frozenset(
    {".bin", ".bmp", ".jpeg", ".jpg", ".json", ".md", ".mtl", ".png", ".tga", ".txt", ".webp"}
)
_OF_SYSTEMS = ("desktop.ini", "thumbs.db")
"""Files that Windows leaves in folders."""


def load_class(
    path: str | Path, object_class: str, *, skip_unreadable: bool = False
) -> tuple[Shape, ...]:
    """Load the meshes of one class of a folder; see `load_folder`."""
    root, folders = Path(path), _class_folders(Path(path))
    if object_class not in folders:
        raise UserError(
            f"Expected a folder {object_class!r} in {root}, got {', '.join(folders)}. "
            "Add it or choose another object_class."
        )
    folder, settings = root / object_class, _settings(root / "shapes.json")
    shapes = []
    for file in _mesh_files(folder):
        name = file.relative_to(root).as_posix()
        try:
            shapes.append(_load_shape(file, name, object_class, root, settings))
        except UserError as error:
            if not skip_unreadable:
                raise UserError(
                    f"Expected a mesh with faces and finite coordinates in {file}, got {error}; "
                    "export it again, remove it, or pass skip_unreadable=True to go on without it."
                ) from error
            warnings.warn(f"Left out {file}: {error}.", UserWarning, stacklevel=2)
    if not shapes:
        raise UserError(
            f"Expected at least one mesh of class {object_class!r} in {folder}, got none; add "
            f"one of {', '.join(MESH_SUFFIXES)} or remove the folder."
        )
    return tuple(shapes)


def load_folder(path: str | Path, *, skip_unreadable: bool = False) -> dict[str, tuple[Shape, ...]]:
    """Load the meshes of a folder that holds one folder a class.

    Files are found at any depth below a class's folder, as ShapeNet nests them. Each becomes one
    shape: a scene's meshes are merged in their places, windings made outward, the whole turned by
    the folder's `FolderSettings` and placed as `Shape` says. All faces are `Material.PAINT`, unless
    the settings ask for the files' materials and textures. Some 2,000 triangles a file are best for
    rendering time, and 500,000 are the most.

    A folder `cad/` holds `cad/car/saloon.obj`, `cad/chair/office.glb` and so on, and optionally
    `cad/shapes.json`, such as `{"up": "+z", "front": "+x"}`. With `skip_unreadable`, a file that
    holds no usable mesh costs a warning. The shapes by class are sorted by name, both; a shape is
    named by its path in the folder.

    Raises:
        ValueError: If the folder is missing, has no class, a class has no mesh, a file has an
            unknown type or, unless `skip_unreadable`, cannot be read or is empty, too large or not
            finite.
    """
    return {
        name: load_class(path, name, skip_unreadable=skip_unreadable)
        for name in _class_folders(Path(path))
    }


def fingerprint(shapes: Iterable[Shape]) -> str:
    """Return the SHA-256, in hexadecimal, of the shapes' classes, names, arrays and surfaces."""
    digest = hashlib.sha256()
    for shape in shapes:
        mesh = (
            getattr(shape, name).astype(np.dtype(dtype).newbyteorder("<"))
            for name, dtype in shape.array_types.items()
        )
        surfaces = (part for surface in shape.surfaces for part in surface.parts())
        for content in (shape.object_class.encode(), shape.name.encode(), *mesh, *surfaces):
            digest.update(len(content).to_bytes(8, "little") + bytes(content))
    return digest.hexdigest()


def _class_folders(root: Path) -> list[str]:
    if not root.is_dir():
        raise UserError(
            f"Expected a folder of CAD files, got {root}, which is not a folder; give the one "
            "that holds one folder a class."
        )
    folders = [entry for entry in root.iterdir() if entry.is_dir() and entry.name[0] != "."]
    if not folders:
        raise UserError(
            f"Expected {root} to hold one folder a class, got none; move the files to a folder "
            f"such as {root / 'car'}."
        )
    return sorted(folder.name for folder in folders)


def _load_shape(
    file: Path, name: str, object_class: str, root: Path, settings: FolderSettings
) -> Shape:
    rotation = settings.rotation()
    if settings.textures:
        textured = read_textured(file, root)
        return assemble_textured(name, object_class, textured, rotation, settings.paint)
    mesh = read_mesh(file)
    mesh = replace(mesh, vertices=mesh.vertices @ rotation.T)
    try:
        shape = assemble(name, object_class, [Part(mesh)])
    except UserError as error:  # all else was checked on reading
        raise UserError("faces without area") from error
    return replace(shape, double_sided=True)


def _mesh_files(folder: Path) -> list[Path]:
    files = []
    for file in sorted(folder.rglob("*")):
        if (
            file.is_dir()
            or file.name.lower() in _OF_SYSTEMS
            or any(part.startswith(".") for part in file.relative_to(folder).parts)
        ):
            continue
        suffix = file.suffix.lower()
        if suffix in MESH_SUFFIXES:
            files.append(file)
        elif suffix not in _COMPANIONS:
            raise UserError(
                f"Expected files of type {', '.join(MESH_SUFFIXES)} in {folder}, got {file}; "
                "convert or remove it."
            )
    return files


def _settings(file: Path) -> FolderSettings:
    if not file.exists():
        return FolderSettings()
    try:
        return FolderSettings.model_validate_json(file.read_bytes().removeprefix(codecs.BOM_UTF8))
    except ValidationError as error:
        flaws = "; ".join(
            f"{'.'.join(map(str, flaw['loc'])) or 'file'}: {flaw['msg']}" for flaw in error.errors()
        )
        raise UserError(
            f'Expected {file} to be such as {{"up": "+y", "front": "-z"}}, got a file with: '
            f"{flaws}; fix it, or remove it for these defaults."
        ) from error


MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl", ".gltf")
"""File types that are read."""

MAX_COORDINATE = 1e9
"""Vertices within 1e-8 are merged; from 1e10 on numbers are coarser than that."""


def read_mesh(file: Path) -> Triangles:
    """Read a file as one mesh with consistent windings, see `wound`.

    Raises:
        UserError: If the file cannot be used; the message says what it holds instead of a mesh.
    """
    with _mesh_errors():
        return wound(_read(file))


def read_textured(file: Path, folder: Path) -> Triangles:
    """Read a file's triangles with its materials and textures, which may lie below a folder.

    Raises:
        UserError: If the file cannot be used; the message says what it holds instead of a mesh.
    """
    member = file.relative_to(folder).as_posix()
    with _mesh_errors():
        return _read(file, Companions.in_folder(folder, member))


@contextmanager
def _mesh_errors() -> Iterator[None]:
    try:
        yield
    except UserError:
        raise
    # readers raise whatever the broken bytes lead them to
    except Exception as error:
        raise UserError(f"a file that cannot be read ({error or type(error).__name__})") from error


def _read(file: Path, companions: Companions | None = None) -> Triangles:
    if not file.is_file():
        raise UserError("something that is not a file")
    if file.stat().st_size > MAX_BYTES:
        raise UserError(f"a file of more than {MAX_BYTES // 2**20:,} MB")
    suffix, content = file.suffix.lower(), file.read_bytes()
    if suffix == ".obj":
        mesh = read_obj(as_text(content), companions)
    elif suffix == ".ply":
        mesh = read_ply(content, companions)
    elif suffix == ".stl":
        mesh = read_stl(content)
    else:
        mesh = read_gltf(content, companions)
    check_count(len(mesh.faces))
    if not len(mesh.faces):
        raise UserError("no faces")
    if not np.isfinite(mesh.vertices).all():
        raise UserError("NaN or infinite coordinates")
    largest = float(np.abs(mesh.vertices).max())
    if largest > MAX_COORDINATE:
        raise UserError(
            f"coordinates up to {largest:.3g}, where at most {MAX_COORDINATE:.0e} is exact enough: "
            "scale it down"
        )
    if companions is not None and not mesh.surfaces:
        return replace(mesh, surfaces=(Surface("", (0.7, 0.7, 0.7)),))
    return mesh
