"""What pictures are drawn with: matplotlib's style, fonts, text, lines, marks, panels."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym.foundations.environment_variables import environment_variables
from sada_gym.foundations.frames import INK, VERMILLION, Colour, Frame, LegendEntry, rgb

Point = tuple[float, float]

INK_RGB = rgb(INK)
_WORDS = re.compile(r"\S+(?: %)?")  # "92 %" stays on one line
_CASING = (64, 72, 80)  # a dark edge, so that a white line shows on white


def _matplotlib() -> Any:
    """Import matplotlib, even where MPLBACKEND names a backend that is not installed."""
    backend = "" if "matplotlib" in sys.modules else os.environ.get("MPLBACKEND", "")
    with environment_variables({"MPLBACKEND": ""} if backend else {}):
        import matplotlib as mpl  # it takes a while; loaded when something is drawn
    if backend:
        with suppress(ValueError):  # it is left to whoever wants to use that backend
            mpl.rcParams["backend"] = backend
    return mpl


@contextmanager
def own_style() -> Iterator[None]:
    """Draw figures in matplotlib's own style, whatever a user's settings and styles say.

    It decorates all that makes or writes a figure, for settings count at both times. Afterwards the
    user's are as before. Figures are made without pyplot, so that no backend of a user's is used.
    """
    _matplotlib()
    from matplotlib import style

    with style.context("default"):
        yield


@lru_cache(maxsize=32)
def font(size: float, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return a font of a size in pixels that has Greek, Cyrillic and mathematical signs."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    fonts = Path(_matplotlib().get_data_path(), "fonts", "ttf")  # it brings them
    return ImageFont.truetype(str(fonts / name), size)


def wrapped(text: str, face: ImageFont.FreeTypeFont, width: float) -> list[str]:
    """Break a text into lines of at most a width in pixels, between words where that is possible.

    Line breaks in the text stay.
    """
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in _WORDS.findall(paragraph):
            rest = word
            if line and face.getlength(f"{line} {rest}") <= width:
                line, rest = f"{line} {rest}", ""
            elif line:
                lines.append(line)
                line = ""
            while len(rest) > 1 and face.getlength(rest) > width:  # a path, for example
                fits = max(1, sum(face.getlength(rest[: n + 1]) <= width for n in range(len(rest))))
                lines.append(rest[:fits])
                rest = rest[fits:]
            line = rest or line
        lines.append(line)
    return lines


def stamped(frame: Frame, text: str) -> Frame:
    """Return a copy of a frame with a text across its top."""
    picture = Image.fromarray(frame)
    size = min(max(picture.width // 32, 10), 24)
    face, draw = font(size), ImageDraw.Draw(picture)
    for i, line in enumerate(wrapped(text, face, picture.width - size)):
        draw.rectangle((0, i * size * 4 // 3, picture.width, (i + 1) * size * 4 // 3), "white")
        draw.text((size // 2, i * size * 4 // 3), line, rgb(VERMILLION), face)
    return np.asarray(picture)


def dashed(
    draw: ImageDraw.ImageDraw,
    points: Sequence[Point],
    colour: Colour,
    width: int,
    dash: float,
    gap: float,
    *,
    casing: Colour | None = None,
) -> None:
    """Draw a line of dashes through points, or a whole one where the gap is 0; all in pixels.

    A `casing` is the colour of an edge of one pixel, which sets the line off from any background.
    """
    pieces = [list(points)] if gap <= 0.0 else _pieces(points, dash, gap)
    for ink, more in ((casing, 2), (colour, 0)):
        for piece in pieces if ink is not None else ():
            draw.line(piece, ink, width + more, joint="curve")


def _pieces(points: Sequence[Point], dash: float, gap: float) -> list[list[Point]]:
    corners = np.asarray(points, float)
    steps = np.hypot(*np.diff(corners, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    pieces: list[list[Point]] = []
    for start in np.arange(0.0, along[-1], dash + gap):
        end = min(start + dash, along[-1])
        inner = along[(along > start) & (along < end)]
        ends = np.concatenate([[start], inner, [end]])
        places = np.stack([np.interp(ends, along, axis) for axis in corners.T], axis=1)
        pieces.append([(float(x), float(y)) for x, y in places])
    return pieces


def _corners(box: Sequence[float]) -> list[Point]:
    x0, y0, x1, y1 = box
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


def cross(
    draw: ImageDraw.ImageDraw, place: Point, arm: float, colour: Colour, widths: tuple[int, int]
) -> None:
    """Draw a diagonal cross, `arm` pixels from its middle to either side, with a white rim.

    `widths` are those of the white strokes and of the coloured ones on top of them.
    """
    x, y = place
    for ink, width in zip(((255, 255, 255), colour), widths, strict=True):
        for up in (-arm, arm):
            draw.line([(x - arm, y - up), (x + arm, y + up)], fill=ink, width=width)


def ring(draw: ImageDraw.ImageDraw, x: float, y: float, radius: float) -> None:
    """Mark a place by a red ring with a white rim, and leave what is there to be seen."""
    draw.circle((x, y), radius + 2, outline="white", width=8)
    draw.circle((x, y), radius, outline=VERMILLION, width=4)


def dashed_box(
    draw: ImageDraw.ImageDraw,
    box: Sequence[float],
    colour: Colour,
    width: int,
    dash: float = 0.0,
    gap: float = 0.0,
    *,
    casing: Colour | None = None,
) -> None:
    """Draw a box (left, top, right, bottom) of four dashed lines, see `dashed`."""
    if casing is not None:
        dashed_box(draw, box, casing, width + 2, dash, gap)
    for side in pairwise(_corners(box)):
        dashed(draw, side, colour, width, dash, gap)


def swatch(draw: ImageDraw.ImageDraw, entry: LegendEntry, box: tuple[int, int, int, int]) -> None:
    """Draw an entry's mark into a box (left, top, right, bottom), in pixels."""
    left, top, right, bottom = box
    x, y, r = (left + right) / 2, (top + bottom) / 2, (bottom - top) / 2
    width = max(2, round(r / 4))
    colour = rgb(entry.colour)
    kind, _, shape = entry.mark.rpartition(" ")
    gaps = {"": (1.0, 0.0), "dashed": (2.5, 1.8), "dotted": (1.0, 1.0)}[kind]
    dash, gap = gaps[0] * width, gaps[1] * width
    if shape == "area":
        draw.rectangle(box, colour, rgb(INK))
    elif shape == "box":
        dashed(draw, _corners(box), colour, width, dash, gap, casing=_CASING)
    elif shape == "line":
        ends = [(left, y), (right, y)]
        dashed(draw, ends, colour, 2 * width, dash * 2, gap * 2, casing=_CASING)
    elif shape == "dots":
        for offset in (-1.2, 0.0, 1.2):
            draw.circle((x + offset * r, y), 0.3 * r, colour)
    elif shape == "disc":
        draw.circle((x, y), 0.8 * r, colour, rgb(INK), max(1, width // 2))
    elif shape == "square":
        draw.rectangle((x - 0.8 * r, y - 0.8 * r, x + 0.8 * r, y + 0.8 * r), colour, rgb(INK))
    elif shape in ("cross", "plus"):
        arm = 0.8 * r
        bars = [(arm, arm), (arm, -arm)] if shape == "cross" else [(arm, 0.0), (0.0, arm)]
        for dx, dy in bars:
            draw.line([(x - dx, y - dy), (x + dx, y + dy)], colour, round(1.6 * width))
    elif shape == "arrow":
        draw.polygon([(x + r, y), (x - 0.8 * r, y - 0.8 * r), (x - 0.8 * r, y + 0.8 * r)], colour)


def caption(text: str, width: int, size: int = 15) -> Image.Image:
    """Write lines of text; what is too long for the width is written smaller.

    The picture's size depends on the number of lines alone, so that frames have one shape.
    """
    lines, height = text.split("\n"), 2 * round(0.75 * size) + 4  # even, for video encoders
    bar = Image.new("RGB", (width, height * len(lines)), "white")
    draw, room = ImageDraw.Draw(bar), width - 12
    for i, line in enumerate(lines):
        shrunk = min(1.0, room / max(1.0, font(size).getlength(line)))
        middle = (6, (i + 0.5) * height)
        draw.text(middle, line, fill=INK_RGB, font=font(int(shrunk * size)), anchor="lm")
    return bar


def resized_into(picture: Image.Image, width: float, height: float) -> Image.Image:
    """Scale a picture to fill a width or a height; the pixels of small ones stay sharp."""
    scale = min(width / picture.width, height / picture.height)
    size = max(1, round(picture.width * scale)), max(1, round(picture.height * scale))
    method = Image.Resampling.NEAREST if scale >= 2 else Image.Resampling.LANCZOS
    return picture.resize(size, method)


def beside(left: Image.Image, right: Image.Image) -> Image.Image:
    """Put two pictures beside one another."""
    pair = Image.new("RGB", (left.width + right.width, left.height), "white")
    pair.paste(left, (0, 0))
    pair.paste(right, (left.width, 0))
    return pair


def inset(picture: Image.Image, small: Image.Image) -> None:
    """Put a small picture, with a white frame, into the upper right corner of another."""
    draw = ImageDraw.Draw(small)
    draw.rectangle((0, 0, small.width - 1, small.height - 1), outline="white", width=2)
    picture.paste(small, (picture.width - small.width - 8, 8))


def stacked(parts: Sequence[Image.Image]) -> Frame:
    """Put pictures below one another."""
    whole = Image.new("RGB", (parts[0].width, sum(part.height for part in parts)), "white")
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    return np.asarray(whole)
