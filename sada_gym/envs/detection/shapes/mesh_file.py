"""One CAD file as one mesh. A file names others only where its textures are wanted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from sada_gym.envs.detection.shapes.companions import MAX_BYTES, Companions
from sada_gym.envs.detection.shapes.gltf import read_gltf
from sada_gym.envs.detection.shapes.obj import read_obj
from sada_gym.envs.detection.shapes.ply import read_ply
from sada_gym.envs.detection.shapes.stl import read_stl
from sada_gym.envs.detection.shapes.surface import Surface
from sada_gym.envs.detection.shapes.triangles import Triangles, as_text, check_count, wound
from sada_gym.errors import UserError

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
