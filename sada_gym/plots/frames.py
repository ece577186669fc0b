"""Frames and what is drawn on them: fonts, wrapped text, dashes, and lines with an edge."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ImageDraw, ImageFont

from sada_gym.application import Frame
from sada_gym.errors import UserError

Colour = tuple[int, int, int]
Point = tuple[float, float]


def checked_frame(given: Any, source: str) -> Frame:
    """Give what an application drew, if it is a frame.

    Args:
        given: Anything.
        source: Where it is from, such as `MyApplication.render`.

    Raises:
        UserError: If it is no frame.
    """
    found = np.asarray(given)
    if found.dtype != np.uint8 or found.ndim != 3 or found.shape[2] != 3 or not found.size:
        raise UserError(
            f"Expected a frame of shape (height, width, 3) and type uint8, got {found.shape} and "
            f"{found.dtype}. Mend {source}."
        )
    return found


def rgb(colour: str) -> Colour:
    """Give the red, green and blue, 0 to 255, of a colour such as `#d55e00`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


@lru_cache(maxsize=32)
def font(size: float, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Give a font of a size in pixels that has Greek, Cyrillic and mathematical signs."""
    import matplotlib as mpl  # it brings the font; loaded when something is drawn

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path(), "fonts", "ttf", name)), size)


def wrapped(text: str, of: ImageFont.FreeTypeFont, width: float) -> list[str]:
    """Break a text into lines of at most a width in pixels, between words where that is possible.

    Args:
        text: The text; line breaks in it stay.
        of: Its font.
        width: The width in pixels.
    """
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            rest = word
            if line and of.getlength(f"{line} {rest}") <= width:
                line, rest = f"{line} {rest}", ""
            elif line:
                lines.append(line)
                line = ""
            while rest and of.getlength(rest) > width and len(rest) > 1:  # a path, for example
                fits = max(1, sum(of.getlength(rest[: n + 1]) <= width for n in range(len(rest))))
                lines.append(rest[:fits])
                rest = rest[fits:]
            line = rest or line
        lines.append(line)
    return lines


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
    """Draw a line of dashes, or a whole one.

    Args:
        draw: Draws on the picture.
        points: The line's corners in pixels.
        colour: Its colour.
        width: Its width in pixels.
        dash: The length of a dash in pixels.
        gap: The length of the gap after it; 0 draws a whole line.
        casing: The colour of an edge of one pixel, which sets the line off from any background.
    """
    pieces = [list(points)] if gap <= 0.0 else _pieces(points, dash, gap)
    for ink, more in ((casing, 2), (colour, 0)):
        for piece in pieces if ink is not None else ():
            draw.line(piece, ink, width + more, joint="curve")


def _pieces(points: Sequence[Point], dash: float, gap: float) -> list[list[Point]]:
    """Cut a line into its dashes."""
    corners = np.asarray(points, float)
    steps = np.hypot(*np.diff(corners, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    found: list[list[Point]] = []
    for start in np.arange(0.0, along[-1], dash + gap):
        end = min(start + dash, along[-1])
        inner = along[(along > start) & (along < end)]
        at = np.concatenate([[start], inner, [end]])
        places = np.stack([np.interp(at, along, axis) for axis in corners.T], axis=1)
        found.append([(float(x), float(y)) for x, y in places])
    return found


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
    x0, y0, x1, y1 = box
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    sides = [*pairwise(corners)]
    if casing is not None:
        for side in sides:
            dashed(draw, side, casing, width + 2, dash, gap)
    for side in sides:
        dashed(draw, side, colour, width, dash, gap)
