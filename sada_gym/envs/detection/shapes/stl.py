"""STL, binary and ASCII, read strictly."""

from __future__ import annotations

import codecs

import numpy as np

from sada_gym.envs.detection.shapes.triangles import Points, Triangles, as_text, check_count
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

_HEAD = 84
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SEARCHED = 10_000
"""Bytes among which an ASCII file has its first facet."""

_FACET = ("facet", "outer", "vertex", "vertex", "vertex", "endloop", "endfacet")


def read_stl(content: bytes) -> Triangles:
    """Read the triangles of an STL file, of all its solids; colours are not part of the format.

    Raises:
        UserError: If the file is damaged; the message says how.
    """
    count = int.from_bytes(content[80:_HEAD], "little")
    exact = len(content) == _HEAD + _RECORD.itemsize * count
    # the header of a binary file may begin with `solid` too
    text = b"\0" not in content and b"facet" in content[:_SEARCHED].lower()
    if not exact and (text or content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))):
        corners = _read_ascii(as_text(content))
    else:
        corners = _read_binary(content, count)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return Triangles(corners.reshape(-1, 3), faces, None, np.zeros(len(faces), np.int64))


def _read_binary(content: bytes, count: int) -> Points:
    room, tail = divmod(len(content) - _HEAD, _RECORD.itemsize)
    if len(content) < _HEAD or room < count:
        raise UserError(f"a binary file that ends after {max(room, 0):,} of {count:,} faces")
    check_count(count)
    if room > count:  # some programs append a few bytes, but what is longer may be a shape
        tail += _RECORD.itemsize * (room - count)
        raise UserError(f"{tail:,} bytes after its {count:,} faces: export each solid on its own")
    return np.frombuffer(content, _RECORD, count, _HEAD)["corners"].astype(float)


def _read_ascii(text: str) -> Points:
    text = text.lower()
    check_count(text.count("endfacet"))
    values: list[str] = []
    inside, step = False, 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if inside and words[0] == _FACET[step]:
            if words[0] == "vertex":
                if len(words) != 4:
                    raise UserError(f"a vertex without three numbers in line {number}")
                values += words[1:]
            step = (step + 1) % len(_FACET)
        elif words[0] == "solid" and not inside:
            inside = True
        elif words[0] in ("endsolid", "end") and inside and step == 0:
            inside = False
        else:
            raise UserError(f"line {number}, which STL does not allow there: {shown(line)!r}")
    if inside:
        raise UserError("a file that ends before its endsolid")
    try:
        return np.array(values, float).reshape(-1, 3, 3)
    except ValueError as error:
        raise UserError(f"a vertex that is not a number ({error})") from error
