"""AC3D, the text format of FlightGear's models, with its materials and textures."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.companions import Companions
from sada_gym.envs.detection.shapes.surface import Surface
from sada_gym.envs.detection.shapes.triangles import Triangles, check_corners, look, triangulate
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

_POLYGON, _LINE = 0, 2
"""Kinds of surfaces, their lowest four bits; what lies above lines are strips."""

_IGNORED = ("name", "crease", "subdiv", "url", "hidden", "locked", "folded")


@dataclass
class _Polygons:
    """Polygons of all objects, in the place that the objects' parents give them."""

    points: list[npt.NDArray[np.float64]] = field(default_factory=list)
    count: int = 0
    corners: list[int] = field(default_factory=list)
    uv: list[tuple[float, float]] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    surface: list[int] = field(default_factory=list)
    used: dict[tuple[int, str], int] = field(default_factory=dict)
    """Surfaces by their material and texture."""


class _Lines:
    """The file's lines, one after another."""

    def __init__(self, text: str) -> None:
        self._lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        self.number = 0

    def next(self) -> list[str]:
        """Return the words of the next line that is not blank; none at the end."""
        while self.number < len(self._lines):
            line = self._lines[self.number]
            self.number += 1
            if line.strip():
                return shlex.split(line) if '"' in line else line.split()
        return []

    def count(self, word: str) -> int:
        """Return a number of things to come, each of which takes a line or more."""
        number = int(word)
        if not 0 <= number <= len(self._lines) - self.number:
            raise ValueError
        return number

    def skip(self, length: int) -> None:
        """Skip a text of so many bytes, line breaks included."""
        while length > 0 and self.number < len(self._lines):
            length -= len(self._lines[self.number].encode("latin-1", "replace")) + 1
            self.number += 1


def read_ac3d(text: str, companions: Companions, hidden: Collection[str] = ()) -> Triangles:
    """Read the triangles of an AC3D file with their colours and textures.

    Objects whose names match one of the patterns `hidden`, such as `light*`, are left out with all
    below them.

    Raises:
        UserError: If the file breaks the format, or holds what is not drawn; the message says what.
    """
    lines, parts, materials = _Lines(text), _Polygons(), []
    if not (lines.next() or [""])[0].startswith("AC3D"):
        raise UserError("a file that does not begin with AC3D")
    try:
        while words := lines.next():
            if words[0] == "MATERIAL":
                materials.append(_material(words))
            elif words[0] == "OBJECT":
                _read_object(lines, parts, np.eye(4), hidden)
            else:
                raise ValueError
    except UserError:
        raise
    except (ValueError, IndexError) as error:
        raise UserError(f"line {lines.number}, which is damaged") from error
    return _joined(parts, materials, companions)


def _material(words: list[str]) -> Surface:
    """Read `MATERIAL "name" rgb r g b amb ... spec ... shi n trans t`."""
    red, green, blue = (float(word) for word in words[words.index("rgb") + 1 :][:3])
    gloss = max(float(word) for word in words[words.index("spec") + 1 :][:3])
    opacity = 1.0 - float(words[words.index("trans") + 1])
    colour = tuple(np.clip((red, green, blue), 0, 1).tolist())
    return Surface(words[1], colour, None, opacity, look(opacity, gloss))


def _read_object(
    lines: _Lines, parts: _Polygons, parent: npt.NDArray[np.float64], hidden: Collection[str] | None
) -> None:
    """Read an object and those below it; with hidden None, for nothing."""
    place, texture, start = np.eye(4), "", parts.count
    laid = [1.0, 1.0, 0.0, 0.0]
    while words := lines.next():
        keyword, *values = words
        if keyword == "name" and hidden is not None:
            hidden = None if any(fnmatch(values[0], pattern) for pattern in hidden) else hidden
        elif keyword == "texture":
            texture = values[0]
        elif keyword == "texrep":
            laid[:2] = map(float, values)
        elif keyword == "texoff":
            laid[2:] = map(float, values)
        elif keyword == "rot":
            place[:3, :3] = np.array(values, float).reshape(3, 3).T
        elif keyword == "loc":
            place[:3, 3] = np.array(values, float)
        elif keyword == "data":
            lines.skip(int(values[0]))
        elif keyword == "numvert":
            points = np.array([lines.next() for _ in range(lines.count(values[0]))], float).reshape(
                -1, 3
            )
            matrix = parent @ place
            if hidden is not None:
                parts.points.append(points @ matrix[:3, :3].T + matrix[:3, 3])
                parts.count += len(points)
        elif keyword == "numsurf":
            for _ in range(lines.count(values[0])):
                _read_surface(
                    lines, parts if hidden is not None else _Polygons(), start, texture, laid
                )
        elif keyword == "kids":
            for _ in range(lines.count(values[0])):
                if lines.next()[0] != "OBJECT":
                    raise ValueError
                _read_object(lines, parts, parent @ place, hidden)
            return
        elif keyword == "subdiv" and int(values[0]):
            raise UserError("an object that is smoothed by subdivision: apply it before exporting")
        elif keyword not in _IGNORED:
            raise UserError(f"no AC3D statement in line {lines.number}: {shown(keyword)!r}")
    raise ValueError


def _read_surface(
    lines: _Lines, parts: _Polygons, start: int, texture: str, laid: Sequence[float]
) -> None:
    keyword, flags = lines.next()
    kind = int(flags, 16) & 15
    if keyword != "SURF" or kind > _LINE:
        raise UserError(f"a surface of kind {kind} in line {lines.number}: cut it into polygons")
    material = 0
    while (words := lines.next())[0] == "mat":
        material = int(words[1])
    if words[0] != "refs":
        raise ValueError
    for _ in range(count := lines.count(words[1])):
        index, u, v = lines.next()[:3]
        if kind == _POLYGON:
            parts.corners.append(start + int(index))
            across, up, right, above = laid
            parts.uv.append((float(u) * across + right, float(v) * up + above))
    if kind == _POLYGON:
        parts.sizes.append(count)
        parts.surface.append(parts.used.setdefault((material, texture), len(parts.used)))


def _joined(parts: _Polygons, materials: list[Surface], companions: Companions) -> Triangles:
    points = np.concatenate([np.empty((0, 3)), *parts.points])
    corners = np.array(parts.corners, np.int64)
    check_corners(corners, len(points))
    if not all(0 <= material < len(materials) for material, _ in parts.used):
        raise UserError("faces that point at missing materials")
    sizes = np.array(parts.sizes, np.int64)
    places, polygon = triangulate(points, corners, sizes)
    surfaces = tuple(
        replace(materials[material], texture=companions.texture(texture) if texture else None)
        for material, texture in parts.used
    )
    uv = np.array(parts.uv).reshape(-1, 2)[places]
    surface = np.array(parts.surface, np.int64)[polygon]
    return Triangles(points, corners[places], uv, surface, surfaces)
