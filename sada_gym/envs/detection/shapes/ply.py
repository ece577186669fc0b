"""PLY, ASCII and binary, read strictly."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
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
from sada_gym.foundations.files import shown

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


@dataclass
class _Ragged:
    """A property that holds a list in each row: its values one after another, and their numbers."""

    sizes: Indices
    values: npt.NDArray[np.float64]


@dataclass
class _Element:
    name: str
    count: int
    types: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Of each property: the type of a list's length, empty where it is no list, and of a value."""


_Columns = Mapping[str, "npt.NDArray[np.float64] | _Ragged"]


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
    """Reads elements one after another: out of words, or of bytes of an order, `<` or `>`."""

    def __init__(self, body: bytes, order: str) -> None:
        self._order = order
        self._content: Any = body if order else body.split()
        self._at = 0

    def element(self, element: _Element) -> _Columns:
        types, width = element.types, self._width
        least = sum(width(length or value) for length, value in types.values())
        if element.count * least > len(self._content) - self._at:
            name = shown(element.name)
            raise UserError(f"a file that ends before its {element.count:,} rows of {name}")
        if any(length for length, _ in types.values()):
            starts, sizes = self._walk(element)
        else:
            starts, sizes = {}, dict.fromkeys(types, np.ones(element.count, np.int64))
            rows = self._at + least * np.arange(element.count)
            for name, (_, value) in types.items():
                starts[name], rows = rows, rows + width(value)
            self._at += least * element.count
        columns = {name: self._values(types[name][1], starts[name], sizes[name]) for name in types}
        return {
            name: _Ragged(sizes[name], column) if types[name][0] else column
            for name, column in columns.items()
        }

    def _walk(self, element: _Element) -> tuple[dict[str, Indices], dict[str, Indices]]:
        """Find where each row's values start, and how long its lists are, which the rows say."""
        width = self._width
        starts: dict[str, list[int]] = {name: [] for name in element.types}
        sizes: dict[str, list[int]] = {name: [] for name in element.types}
        fields = [
            (starts[name].append, sizes[name].append, length, self._number(length), width(value))
            for name, (length, value) in element.types.items()
        ]
        at, end = self._at, len(self._content)
        for _ in range(element.count):
            for start, size, length, number, step in fields:
                items = 1
                if length:
                    if at + width(length) > end or (items := number(at)) < 0:
                        raise UserError("a file that ends within its rows")
                    at += width(length)
                start(at)
                size(items)
                at += items * step
        if at > end:
            raise UserError("a file that ends within its rows")
        self._at = at
        found = [
            {name: np.array(n, np.int64) for name, n in part.items()} for part in (starts, sizes)
        ]
        return found[0], found[1]

    def _width(self, kind: str) -> int:
        return 0 if not kind else np.dtype(kind).itemsize if self._order else 1

    def _number(self, kind: str) -> Callable[[int], int]:
        """Return what reads a number of a type at a place."""
        if not kind or not self._order:
            return lambda at: int(self._content[at])
        unpack = struct.Struct(self._order + np.dtype(kind).char).unpack_from
        return lambda at: int(unpack(self._content, at)[0])

    def _values(self, kind: str, starts: Indices, sizes: Indices) -> npt.NDArray[np.float64]:
        first = starts - self._width(kind) * (np.cumsum(sizes) - sizes)
        places = np.repeat(first, sizes) + self._width(kind) * np.arange(sizes.sum())
        if not self._order:
            return _numbers([self._content[place] for place in places.tolist()], kind)
        content = np.frombuffer(self._content, np.uint8)
        bits = content[places[:, None] + np.arange(self._width(kind))]
        return np.asarray(bits.view(self._order + kind)[:, 0], float)


def _numbers(words: list[bytes], kind: str) -> npt.NDArray[np.float64]:
    """Read numbers, as coarse as the file declares them."""
    try:
        values = np.array(words, "S").astype(float) if words else np.empty(0)
        return values.astype("f4").astype(float) if kind == "f4" else values
    except ValueError as error:
        raise UserError(f"a value that is not a number ({error})") from error


def _triangles(
    columns: Mapping[str, _Columns], textures: list[str], companions: Companions | None
) -> Triangles:
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    polygons = face.get("vertex_indices", face.get("vertex_index"))
    axes = [vertex.get(axis) for axis in "xyz"]
    if polygons is None:
        return Triangles(np.empty((0, 3)), np.empty((0, 3), np.int64), None, np.empty(0, np.int64))
    points = _table(axes)
    if not isinstance(polygons, _Ragged) or points is None:
        raise UserError("vertices without x, y and z, or faces without a list of vertices")
    corners = polygons.values.astype(np.int64)
    if (corners != polygons.values).any():
        raise UserError("indices that are not whole numbers")
    places, polygon = triangulate(points, corners, polygons.sizes)
    order = _order(polygon, polygons.sizes)
    places, polygon = places[order], polygon[order]
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


def _order(polygon: Indices, sizes: Indices) -> Indices:
    """Sort triangles as fingerprints of users' files have known them: quads' halves apart."""
    half = np.arange(len(polygon)) - np.searchsorted(polygon, polygon)
    size = sizes[polygon] if len(polygon) else polygon
    return np.lexsort((polygon, np.where(size == 4, half, 0), np.clip(size, 3, 5)))


def _texture_coordinates(
    vertex: _Columns, face: _Columns, sizes: Indices, places: Indices, faces: Indices
) -> Points | None:
    """Return uv, (f, 3, 2), of the corners' own lists or of the vertices; None without any."""
    own = face.get("texcoord")
    if isinstance(own, _Ragged):
        if (own.sizes != 2 * sizes).any():
            raise UserError("faces whose texcoord has not two numbers a corner")
        return own.values.reshape(-1, 2)[places]
    for names in _UV:
        table = _table([vertex.get(name) for name in names])
        if table is not None:
            return np.asarray(table[faces])
    return None


def _table(columns: Sequence[npt.NDArray[np.float64] | _Ragged | None]) -> Points | None:
    """Put columns side by side; None if one is missing or a list."""
    arrays = [column for column in columns if isinstance(column, np.ndarray)]
    return np.column_stack(arrays) if len(arrays) == len(columns) else None
