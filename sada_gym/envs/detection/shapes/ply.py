"""PLY, ASCII and binary, read strictly."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.companions import Companions
from sada_gym.envs.detection.shapes.surface import Surface
from sada_gym.envs.detection.shapes.triangles import (
    Indices,
    Points,
    Triangles,
    as_text,
    check_count,
    triangulate,
)
from sada_gym.errors import UserError
from sada_gym.files import shown

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


@dataclass
class _List:
    """A property that holds a list in each row: its values one after another, and their numbers."""

    sizes: Indices
    values: npt.NDArray[np.float64]


@dataclass
class _Element:
    name: str
    count: int
    types: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Of each property: the type of a list's length, empty where it is no list, and of a value."""


_Columns = Mapping[str, "npt.NDArray[np.float64] | _List"]


def read_ply(content: bytes, companions: Companions | None = None) -> Triangles:
    """Read the triangles of a PLY file; with companions, its textures too.

    Raises:
        UserError: If the file breaks the format, or holds what is not drawn; the message says what.
    """
    head, end, body = content.partition(b"end_header")
    if not end or not as_text(head).lstrip().startswith("ply"):
        raise UserError("a file without a PLY header")
    line_break = b"\r\n" if body.startswith(b"\r\n") else body[:1]
    body = body[len(line_break) :]
    order, elements, textures = _header(as_text(head))
    for element in elements:
        if element.name == "face":
            check_count(element.count)
        elif element.name == "tristrips" and element.count:
            raise UserError("strips of triangles (tristrips): export faces")
    rows = _Rows(body, order)
    columns = {element.name: rows.element(element) for element in elements}
    return _triangles(columns, textures, companions)


def _header(text: str) -> tuple[str, list[_Element], list[str]]:
    order, elements, textures = None, [], []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split() or [""]
        try:
            if words[0] == "format":
                order = _FORMATS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].types[words[4]] = _TYPES[words[2]], _TYPES[words[3]]
            elif words[0] == "property":
                elements[-1].types[words[2]] = "", _TYPES[words[1]]
            elif words[:2] == ["comment", "TextureFile"]:
                textures.append(line.split(None, 2)[2])
            elif words[0] not in ("ply", "comment", "obj_info", ""):
                raise KeyError
        except (KeyError, IndexError, ValueError) as error:
            raise UserError(f"line {number}, which PLY does not have: {shown(line)!r}") from error
    if order is None or any(element.count < 0 for element in elements):
        raise UserError("a header without a format, or with an element of less than no rows")
    return order, elements, textures


class _Rows:
    """The rows of a file: bytes of a binary one, words of a text."""

    def __init__(self, body: bytes, order: str) -> None:
        self._content = body if order else body.split()
        self._order = order
        self._at = 0

    def element(self, element: _Element) -> _Columns:
        """Read the rows of an element, all at once where none holds a list."""
        types = element.types
        least = sum(
            int((length or value)[1]) if self._order else 1 for length, value in types.values()
        )
        if element.count * least > len(self._content) - self._at:
            raise UserError(
                f"a file that ends before its {element.count:,} rows of {shown(element.name)}"
            )
        if not any(length for length, _ in types.values()):
            return self._table(element)
        sizes: dict[str, list[int]] = {name: [] for name in types}
        values: dict[str, list[Any]] = {name: [] for name in types}
        for _ in range(element.count):
            for name, (length, value) in types.items():
                size = int(self._take(length, 1)[0]) if length else 1
                sizes[name].append(size)
                values[name] += self._take(value, size)
        columns = {name: _numbers(values[name], value) for name, (_, value) in types.items()}
        return {
            name: _List(np.array(sizes[name], np.int64), columns[name]) if length else columns[name]
            for name, (length, _) in types.items()
        }

    def _table(self, element: _Element) -> _Columns:
        kinds = {name: value for name, (_, value) in element.types.items()}
        if not self._order:
            words = self._next(element.count * len(kinds))
            return {
                name: _numbers(words[i :: len(kinds)], kind)
                for i, (name, kind) in enumerate(kinds.items())
            }
        row = np.dtype([(name, self._order + kind) for name, kind in kinds.items()])
        rows = np.frombuffer(self._next(element.count * row.itemsize), row)
        return {name: rows[name].astype(float) for name in kinds}

    def _take(self, kind: str, count: int) -> Any:
        """Take some values of a type; those of a text are words."""
        if not self._order or count < 0:
            return self._next(count)
        content = self._next(int(kind[1]) * count)
        return struct.unpack(f"{self._order}{count}{_CODES[kind]}", content)

    def _next(self, length: int) -> Any:
        start, self._at = self._at, self._at + length
        if length < 0 or self._at > len(self._content):
            raise UserError("a file that ends within its rows")
        return self._content[start : self._at]


def _numbers(values: Sequence[Any], kind: str) -> npt.NDArray[np.float64]:
    """Make numbers of words or values, as coarse as the file declares them."""
    try:
        numbers = np.array(values).astype(float)
        return numbers.astype("f4").astype(float) if kind == "f4" else numbers
    except ValueError as error:
        raise UserError(f"a value that is no number ({error})") from error


def _triangles(
    columns: Mapping[str, _Columns], textures: list[str], companions: Companions | None
) -> Triangles:
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    axes = [vertex.get(axis) for axis in "xyz"]
    if polygons is None:
        return Triangles(np.empty((0, 3)), np.empty((0, 3), np.int64), None, np.empty(0, np.int64))
    points = _table(axes)
    if not isinstance(polygons, _List) or points is None:
        raise UserError("vertices without x, y and z, or faces without a list of vertices")
    corners = polygons.values.astype(np.int64)
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise UserError("faces that point at missing vertices")
    if (corners != polygons.values).any():
        raise UserError("indices that are not whole numbers")
    check_count(int((polygons.sizes - 2).clip(0).sum()))
    places, polygon = triangulate(points, corners, polygons.sizes)
    faces, nothing = corners[places], np.zeros(len(places), np.int64)
    if companions is None:
        return Triangles(points, faces, None, nothing)
    if "red" in vertex or "red" in face:
        raise UserError(
            "colours of vertices or faces, which are not drawn: bake them into a texture"
        )
    uv = _texture_coordinates(vertex, face, polygons.sizes, places, faces) if textures else None
    number = face.get("texnumber")
    surface = number.astype(np.int64)[polygon] if isinstance(number, np.ndarray) else nothing
    if uv is None:
        return Triangles(points, faces, None, nothing, (Surface("", (0.7, 0.7, 0.7)),))
    if len(surface) and not 0 <= surface.min() <= surface.max() < len(textures):
        raise UserError("faces that point at missing textures")
    surfaces = tuple(Surface(name, texture=companions.texture(name)) for name in textures)
    return Triangles(points, faces, uv, surface, surfaces)


def _texture_coordinates(
    vertex: _Columns, face: _Columns, sizes: Indices, places: Indices, faces: Indices
) -> Points | None:
    """Return uv, (f, 3, 2), of the corners' own lists or of the vertices; None without any."""
    own = face.get("texcoord")
    if isinstance(own, _List):
        if (own.sizes != 2 * sizes).any():
            raise UserError("faces whose texcoord has not two numbers a corner")
        return own.values.reshape(-1, 2)[places]
    for names in _UV:
        table = _table([vertex.get(name) for name in names])
        if table is not None:
            return np.asarray(table[faces])
    return None


def _table(columns: Sequence[npt.NDArray[np.float64] | _List | None]) -> Points | None:
    """Put columns side by side; None if one is missing or a list."""
    arrays = [column for column in columns if isinstance(column, np.ndarray)]
    return np.column_stack(arrays) if len(arrays) == len(columns) else None
