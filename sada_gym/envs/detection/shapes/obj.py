"""Wavefront OBJ and its materials (MTL), read strictly."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.companions import Companions, Texture
from sada_gym.envs.detection.shapes.surface import Surface
from sada_gym.envs.detection.shapes.triangles import (
    Indices,
    Points,
    Triangles,
    as_text,
    check_count,
    look,
    triangulate,
)
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

_IGNORED = frozenset(
    # points, lines and curves have no area; groups, normals and hints do not change the surface
    {"p", "l", "vn", "vp", "g", "o", "s", "mg", "usemap", "maplib", "bevel", "c_interp"}
    | {"d_interp", "lod", "shadow_obj", "trace_obj", "cstype", "deg", "bmat", "step", "curv"}
    | {"curv2", "cdc", "res", "parm", "trim", "hole", "scrv", "sp", "end", "con", "ctech", "stech"}
)
_REFUSED = {
    **dict.fromkeys(("surf", "bzp", "bsp", "cdp"), "a free-form surface"),
    "call": "a call of another file",
    "csh": "a command for the shell",
}
_WITH_NAME = ("usemtl", "newmtl", "mtllib", "map_")
_NO_TEXT = -2
_NO_MATERIAL = ("", "None", "(null)")
"""Names of what has no material, as exporters write them."""

_MAP_OPTIONS = {  # and how many words follow; these change nothing that is drawn here
    **dict.fromkeys(("-blendu", "-blendv", "-cc", "-texres", "-bm", "-boost"), 1)
}


@dataclass
class _Statements:
    """What an OBJ file says; indices count from 0."""

    positions: array[float] = field(default_factory=lambda: array("d"))
    coordinates: array[float] = field(default_factory=lambda: array("d"))
    vertices: array[int] = field(default_factory=lambda: array("q"))
    texts: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("q"))
    words: array[int] = field(default_factory=lambda: array("q"))
    materials: array[int] = field(default_factory=lambda: array("q"))
    names: dict[str, int] = field(default_factory=dict)
    """Of materials, in the order of their use; empty where a face has none."""
    libraries: list[str] = field(default_factory=list)
    coloured: bool = False


def read_obj(text: str, companions: Companions | None = None) -> Triangles:
    """Read the triangles of an OBJ file; with companions, its materials and textures too.

    Raises:
        UserError: If the file breaks the format, or holds what is not drawn; the message says what.
    """
    check_count(text.count("\nf ") + text.count("\nf\t"))
    said = _statements(text)
    points = np.array(said.positions).reshape(-1, 3)
    corners = np.array(said.vertices, np.int64)
    sizes, material = np.array(said.sizes, np.int64), np.array(said.materials, np.int64)
    places, polygon = triangulate(points, corners, sizes)
    order = _order(polygon, sizes, np.array(said.words, np.int64), material)
    places, surface = places[order], material[polygon[order]]
    if companions is None:
        return Triangles(points, corners[places], None, np.zeros(len(places), np.int64))
    if said.coloured:
        raise UserError("colours of vertices, which are not drawn: bake them into a texture")
    finishes = _finishes(said, companions)
    uv, textured = _texture_coordinates(said, places, surface, finishes)
    surfaces = [finish.surface for finish in finishes]
    bare = [replace(item, texture=None) for item in surfaces]
    surface = np.where(textured, surface, surface + len(surfaces))
    return Triangles(points, corners[places], uv, surface, (*surfaces, *bare))


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement with its line's number, without comments; continued lines are joined.

    Statements with a name keep theirs, for `#` may belong to it: see `_named`.
    """
    started = ""
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        bare, comment, _ = line.partition("#")
        if not f"{started}{line}".lstrip().lower().startswith(_WITH_NAME):
            line = bare
        if not comment and line.rstrip().endswith("\\"):
            started += line.rstrip()[:-1] + " "
            continue
        yield number, started + line
        started = ""
    yield number, started


def _statements(text: str) -> _Statements:
    said = _Statements()
    material = -1
    for number, line in _lines(text):
        keyword, *words = line.split() or [""]
        try:
            if keyword == "v":
                _add_position(said, words)
            elif keyword == "vt":
                said.coordinates.extend([*map(float, words), 0.0][:2])
            elif keyword == "f":
                if material < 0:
                    material = said.names.setdefault("", len(said.names))
                _add_face(said, words)
                said.materials.append(material)
            elif keyword == "usemtl":
                material = said.names.setdefault(_rest(line), len(said.names))
            elif keyword == "mtllib":
                said.libraries.append(_rest(line))
            elif keyword in _REFUSED:
                raise UserError(f"{_REFUSED[keyword]} ({keyword}) in line {number}; leave it out")
            elif keyword and keyword != "\x1a" and keyword not in _IGNORED:
                raise UserError(f"no OBJ statement in line {number}: {shown(line)!r}")
        except _VertexZeroError as error:
            raise UserError(
                f"a face with the vertex 0 in line {number}, where OBJ counts vertices from 1, or "
                "from -1 backwards"
            ) from error
        except ValueError as error:
            if isinstance(error, UserError):
                raise
            raise UserError(f"line {number}, which is damaged: {shown(line)!r}") from error
    return said


class _VertexZeroError(Exception):
    pass


def _rest(line: str) -> str:
    rest = " ".join(line.split(None, 1)[1:]).strip()
    return "" if rest.startswith("# ") else rest


def _add_position(said: _Statements, words: list[str]) -> None:
    # a fourth number weighs curves alone; three or four more are a colour
    if len(words) not in (3, 4, 6, 7):
        raise ValueError
    said.positions.extend(map(float, words[:3]))
    said.coloured |= len(words) > 4


def _add_face(said: _Statements, words: list[str]) -> None:
    points, coordinates = len(said.positions) // 3, len(said.coordinates) // 2
    parts = len(words)
    for word in words:
        vertex, *others = word.split("/")
        index = int(vertex)
        if not index:
            raise _VertexZeroError
        said.vertices.append(index - 1 if index > 0 else points + index)
        place = _NO_TEXT
        if others and others[0]:
            text = int(others[0])
            # what lies outside is found where textures are wanted
            place = text - 1 if text > 0 else max(coordinates + text, -1) if text else -1
        said.texts.append(place)
        parts += sum(map(bool, others))
    said.sizes.append(len(words))
    said.words.append(parts)


def _order(polygon: Indices, sizes: Indices, words: Indices, material: Indices) -> Indices:
    """Sort triangles as fingerprints of users' files have known them: by materials, last first."""
    if not len(polygon):
        return polygon
    _, first, group = np.unique(material, return_index=True, return_inverse=True)
    fewest, most = np.full(len(first), words.max()), np.zeros(len(first), np.int64)
    np.minimum.at(fewest, group, words)
    np.maximum.at(most, group, words)
    # where all faces of a material have four corners, their first halves come before the others
    halved = (fewest == most)[group] & (sizes == 4)
    half = np.arange(len(polygon)) - np.searchsorted(polygon, polygon)
    return np.lexsort((polygon, np.where(halved[polygon], half, 0), -first[group][polygon]))


def _texture_coordinates(
    said: _Statements, places: Indices, surface: Indices, finishes: list[_Finish]
) -> tuple[Points | None, npt.NDArray[np.bool_]]:
    """Return uv, (f, 3, 2), and which faces have them; None where no material has a texture."""
    textured = np.array([finish.surface.texture is not None for finish in finishes])[surface]
    texts = np.array(said.texts, np.int64)[places]
    textured &= (texts != _NO_TEXT).all(axis=1)
    if not textured.any():
        return None, textured
    coordinates = np.array(said.coordinates).reshape(-1, 2)
    used = texts[textured]
    if used.min() < 0 or used.max() >= len(coordinates):
        raise UserError("faces that point at missing texture coordinates")
    uv = np.zeros((*texts.shape, 2))
    scale = np.array([finish.scale for finish in finishes])[surface][textured]
    offset = np.array([finish.offset for finish in finishes])[surface][textured]
    uv[textured] = coordinates[used] * scale[:, None] + offset[:, None]
    return uv, textured


@dataclass(frozen=True)
class _Finish:
    """A material, and how its texture is laid: uv times scale plus offset."""

    surface: Surface
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


def _finishes(said: _Statements, companions: Companions) -> list[_Finish]:
    """Return the materials in the order of their names; textures that no face has are not read."""
    blocks: dict[str, dict[str, str]] = {name: {} for name in _NO_MATERIAL}
    for library in said.libraries:
        # one name with blanks in it, or several names
        whole = _file(library, companions)
        several = library if all(map(companions.find, library.split())) else _bare(library)
        for name in [whole] if companions.find(whole) else several.split():
            blocks |= _read_mtl(as_text(companions.read(name)))
    names = [_named(name, blocks) for name in said.names]
    return [_finish(name, blocks[name], companions) for name in names]


def _bare(name: str) -> str:
    return name.partition("#")[0].strip()


def _named(name: str, blocks: Mapping[str, object]) -> str:
    """Return the material that a name means; only a name that is not there may hold a comment."""
    commented = [other for other in blocks if _bare(other) == name]
    for known in (name, _bare(name) or name, *commented[-1:]):
        if known in blocks:
            return known
    raise UserError(f"a material {shown(name)!r} that no material file defines")


def _file(name: str, companions: Companions) -> str:
    """Return the name of a file, without a comment where no file has all of it as its name."""
    return name if companions.find(name) else _bare(name)


def _read_mtl(text: str) -> dict[str, dict[str, str]]:
    blocks: dict[str, dict[str, str]] = {}
    block: dict[str, str] = {}
    for _, line in _lines(text):
        keyword = (line.split() or [""])[0].lower()
        if keyword == "newmtl":
            block = blocks.setdefault(_rest(line), {})
        elif keyword:
            block[keyword] = _rest(line)
    return blocks


def _finish(name: str, block: dict[str, str], companions: Companions) -> _Finish:
    try:
        colour = _colour(block.get("kd", "0.7"))
        gloss = max(_colour(block.get("ks", "0")))
        opacity = 1.0 - float(block["tr"]) if "tr" in block else 1.0
        if "d" in block:
            opacity = float(block["d"].split()[-1])
    except (ValueError, IndexError) as error:
        raise UserError(
            f"a material {shown(name)!r} whose Kd, Ks, d or Tr is not a number"
        ) from error
    texture, finish = None, _Finish(Surface())
    if block.get("map_kd"):
        file, finish = _map(name, block["map_kd"])
        texture = companions.texture(_file(file, companions))
        colour = colour if any(colour) else (1.0, 1.0, 1.0)  # exporters mean: no colour but this
    if block.get("map_d"):
        file, _ = _map(name, block["map_d"])
        texture = _with_alpha(texture, companions.texture(_file(file, companions)))
    surface = Surface(name, colour, texture, opacity, look(opacity, gloss))
    return replace(finish, surface=surface)


def _colour(words: str) -> tuple[float, float, float]:
    red, *others = (min(max(float(word), 0.0), 1.0) for word in words.split())
    green, blue = others or (red, red)
    return red, green, blue


def _map(name: str, words: str) -> tuple[str, _Finish]:
    """Split a texture's options from its file's name, which may hold blanks."""
    moved = {"-s": (1.0, 1.0), "-o": (0.0, 0.0)}
    while words.startswith("-"):
        option, _, words = words.partition(" ")
        count = _MAP_OPTIONS.get(option, 0)
        numbers: list[float] = []
        while option in moved and len(numbers) < 3 and _is_number(words.split(" ")[0]):
            number, _, words = words.partition(" ")
            numbers.append(float(number))
        if numbers:
            moved[option] = (numbers[0], [*numbers, moved[option][1]][1])
        elif not count:
            raise UserError(
                f"a texture of {shown(name)!r} with the option {shown(option)}, which is not drawn"
            )
        words = words.split(" ", count)[-1].strip()
    return words, _Finish(Surface(), moved["-s"], moved["-o"])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _with_alpha(texture: Texture | None, mask: Texture) -> Texture:
    """Take a picture's alpha, or its brightness where it is opaque, as the alpha of another."""
    alpha = mask[..., 3] if mask[..., 3].min() < 255 else mask[..., :3].mean(axis=2)
    if texture is None:
        texture = np.full_like(mask, 255)
    if texture.shape != mask.shape:
        raise UserError("map_d of another size than map_Kd, which is not drawn")
    return np.dstack([texture[..., :3], alpha.astype(np.uint8)])
