"""PLY, ASCII and binary, read strictly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

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
    read = _Binary(body, order) if order else _Ascii(body)
    columns = {element.name: read.element(element) for element in elements}
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


class _Ascii:
    """Reads elements out of a text, one row after another."""

    def __init__(self, body: bytes) -> None:
        self._words = body.split()
        self._at = 0

    def element(self, element: _Element) -> _Columns:
        count, types = element.count, element.types
        if count * len(types) > len(self._words) - self._at:
            raise UserError(f"a file that ends before its {count:,} rows of {shown(element.name)}")
        scalars: dict[str, list[bytes]] = {
            name: [] for name, (size, _) in types.items() if not size
        }
        if len(scalars) == len(types):
            block = self._take(count * len(types))
            return {
                name: _numbers(block[i :: len(types)], types[name][1])
                for i, name in enumerate(types)
            }
        lists: dict[str, tuple[list[int], list[bytes]]] = {
            name: ([], []) for name, (size, _) in types.items() if size
        }
        for _ in range(count):
            for name in types:
                if name in scalars:
                    scalars[name] += self._take(1)
                else:
                    size = int(self._take(1)[0])
                    lists[name][0].append(size)
                    lists[name][1].extend(self._take(size))
        return {
            name: _numbers(scalars[name], value)
            if name in scalars
            else _List(np.array(lists[name][0], np.int64), _numbers(lists[name][1], value))
            for name, (_, value) in types.items()
        }

    def _take(self, count: int) -> list[bytes]:
        taken = self._words[self._at : self._at + count]
        if len(taken) != count or count < 0:
            raise UserError("a file that ends within its rows")
        self._at += count
        return taken


class _Binary:
    """Reads elements out of bytes, one row after another."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order = body, order
        self._at = 0

    def element(self, element: _Element) -> _Columns:
        types = element.types
        lists = [name for name in types if types[name][0]]
        sizes = {name: self._first_size(types, name) if element.count else 0 for name in lists}
        rows = self._uniform(element, sizes)
        if rows is None:
            return self._ragged(element)
        self._at += rows.nbytes
        return {
            name: _List(np.full(len(rows), sizes[name]), rows[name].astype(float).ravel())
            if name in sizes
            else rows[name].astype(float)
            for name in types
        }

    def _uniform(self, element: _Element, sizes: Mapping[str, int]) -> npt.NDArray[np.void] | None:
        """Read rows whose lists are as long as the first row's; None where others come."""
        fields: list[tuple[str, str] | tuple[str, str, int]] = []
        for name, (length, value) in element.types.items():
            if length:
                fields += [(f"{name} size", self._order + length)]
                fields += [(name, self._order + value, sizes[name])]
            else:
                fields += [(name, self._order + value)]
        dtype = np.dtype(fields)
        if dtype.itemsize * element.count > len(self._body) - self._at:
            if sizes:
                return None  # some row may be shorter
            raise UserError(
                f"a file that ends before its {element.count:,} rows of {shown(element.name)}"
            )
        rows = np.frombuffer(self._body, dtype, element.count, self._at)
        same = all((rows[f"{name} size"] == size).all() for name, size in sizes.items())
        return rows if same else None

    def _first_size(self, types: Mapping[str, tuple[str, str]], wanted: str) -> int:
        at = self._at
        for name, (length, value) in types.items():
            size = int(self._values(length, at, 1)[0]) if length else 1
            if name == wanted:
                return size
            at += np.dtype(value).itemsize * size + (np.dtype(length).itemsize if length else 0)
        raise AssertionError

    def _values(self, kind: str, at: int, count: int) -> npt.NDArray[np.float64]:
        dtype = np.dtype(self._order + kind)
        if count < 0 or at + count * dtype.itemsize > len(self._body):
            raise UserError("a file that ends within its rows")
        return np.frombuffer(self._body, dtype, count, at).astype(float)

    def _ragged(self, element: _Element) -> _Columns:
        values: dict[str, list[npt.NDArray[np.float64]]] = {name: [] for name in element.types}
        for _ in range(element.count):
            for name, (length, value) in element.types.items():
                size = 1
                if length:
                    size = int(self._values(length, self._at, 1)[0])
                    self._at += np.dtype(length).itemsize
                values[name].append(self._values(value, self._at, size))
                self._at += np.dtype(value).itemsize * size
        empty = np.empty(0)
        return {
            name: _List(np.array([len(v) for v in values[name]], np.int64), joined)
            if length
            else joined
            for name, (length, _) in element.types.items()
            for joined in [np.concatenate([empty, *values[name]])]
        }


def _numbers(words: list[bytes], kind: str) -> npt.NDArray[np.float64]:
    """Read numbers, as coarse as the file declares them."""
    try:
        values = np.array(words, "S").astype(float) if words else np.empty(0)
        return values.astype("f4").astype(float) if kind == "f4" else values
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
