"""One CAD file as one mesh: read from memory alone, so that a file can name no other one."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh

from sada_gym.errors import UserError

MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl")
"""File types that are read."""

MAX_FACES = 500_000
"""Faces of one file: they take some 12 seconds to load, and 0.4 seconds a picture."""

MAX_COORDINATE = 1e9
"""Vertices within 1e-8 are merged; from 1e10 on numbers are coarser than that."""

MAX_BYTES = 2**30
"""Size of one file, which is read into memory."""


def read_mesh(file: Path) -> trimesh.Trimesh:
    """Read a file as one mesh with consistent windings.

    Raises:
        UserError: If the file cannot be used; the message says what it holds instead of a mesh.
    """
    try:
        return _read(file)
    except UserError:
        raise
    # Trimesh raises whatever the broken bytes lead it to.
    except Exception as error:
        raise UserError(f"a file that cannot be read ({error or type(error).__name__})") from error


def _read(file: Path) -> trimesh.Trimesh:
    if not file.is_file():
        raise UserError("something that is not a file")
    if file.stat().st_size > MAX_BYTES:
        raise UserError(f"a file of more than {MAX_BYTES // 2**20:,} MB")
    suffix = file.suffix.lower()
    content = _as_utf8(file.read_bytes(), suffix)
    if suffix == ".obj":
        _check_vertices(content)
    scene = trimesh.load_scene(
        BytesIO(content), file_type=suffix[1:], process=False, skip_materials=True
    )
    _check_faces(scene)
    solids = [solid for solid in scene.dump() if isinstance(solid, trimesh.Trimesh)]
    vertices = [np.asarray(solid.vertices, float) for solid in solids]
    if not all(np.isfinite(points).all() for points in vertices):
        raise UserError("NaN or infinite coordinates")
    largest = max(float(np.abs(points).max(initial=0)) for points in vertices)
    if largest > MAX_COORDINATE:
        raise UserError(
            f"coordinates up to {largest:.3g}, where at most {MAX_COORDINATE:.0e} is exact enough: "
            "scale it down"
        )
    faces = joined_faces(solids)
    if faces.min() < 0 or faces.max() >= sum(map(len, vertices)):
        raise UserError("faces that point at missing vertices")
    mesh = trimesh.Trimesh(np.concatenate(vertices), faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    trimesh.repair.fix_normals(mesh, multibody=True)  # type: ignore[no-untyped-call]
    return mesh


def joined_faces(meshes: Sequence[trimesh.Trimesh]) -> npt.NDArray[np.int64]:
    """Number the faces of meshes, (f, 3), for their vertices one after another."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return np.concatenate(
        [np.asarray(mesh.faces) + start for mesh, start in zip(meshes, starts, strict=True)]
    )


def _check_vertices(content: bytes) -> None:
    # trimesh would take the vertex 0 for the last one
    is_face = continued = False
    for number, line in enumerate(content.splitlines(), 1):
        words = line.partition(b"#")[0].split()
        if not continued:
            is_face = words[:1] == [b"f"]
        if is_face and any(not word.partition(b"/")[0].strip(b"+-0") for word in words):
            raise UserError(
                f"a face with the vertex 0 in line {number}, where OBJ counts vertices from 1, or "
                "from -1 backwards"
            )
        continued = line.endswith(b"\\")


def _check_faces(scene: trimesh.Scene) -> None:
    # counted before they are laid out: a small file may show one mesh a million times
    nodes = scene.graph.geometry_nodes
    faces = sum(
        len(geometry.faces) * len(nodes.get(name, ()))
        for name, geometry in scene.geometry.items()
        if isinstance(geometry, trimesh.Trimesh)
    )
    if not faces:
        raise UserError("no faces")
    if faces > MAX_FACES:
        raise UserError(
            f"{faces:,} faces, where at most {MAX_FACES:,} are rendered in good time: reduce them, "
            "such as with Blender's Decimate modifier"
        )


def _as_utf8(content: bytes, suffix: str) -> bytes:
    # comments and names may stand in other encodings, for which trimesh wants another package
    if suffix == ".glb":
        content[20 : 20 + int.from_bytes(content[12:16], "little")].decode()  # or it is no GLB
        return content
    if suffix == ".ply":
        header, end, body = content.partition(b"end_header")
        return _recoded(header) + end + body
    if suffix == ".stl" and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little"):
        return content  # binary
    return _recoded(content)


def _recoded(text: bytes) -> bytes:
    if text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return text.decode("utf-16").encode()
    try:
        return text.decode("utf-8-sig").encode()
    except UnicodeDecodeError:
        return text.decode("latin-1").encode()
