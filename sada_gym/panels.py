"""Pictures of rollouts for people: parts beside and below one another, with lines of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.drawing import font
from sada_gym.frames import Frame

INK = (31, 41, 51)
_SIZE = 15


def caption(text: str, width: int, size: int = _SIZE) -> Image.Image:
    """Write lines of text; what is too long for the width is written smaller.

    The picture's size depends on the number of lines alone, so that frames have one shape.

    Args:
        text: The text, with line breaks.
        width: The picture's width in pixels.
        size: The font's size in pixels.
    """
    lines, height = text.split("\n"), 2 * round(0.75 * size) + 4  # even, for video encoders
    bar = Image.new("RGB", (width, height * len(lines)), "white")
    draw, room = ImageDraw.Draw(bar), width - 12
    for i, line in enumerate(lines):
        shrunk = min(1.0, room / max(1.0, font(size).getlength(line)))
        middle = (6, (i + 0.5) * height)
        draw.text(middle, line, fill=INK, font=font(int(shrunk * size)), anchor="lm")
    return bar


def beside(left: Image.Image, right: Image.Image) -> Image.Image:
    """Put two pictures beside one another."""
    pair = Image.new("RGB", (left.width + right.width, left.height), "white")
    pair.paste(left, (0, 0))
    pair.paste(right, (left.width, 0))
    return pair


def stacked(parts: Sequence[Image.Image]) -> Frame:
    """Put pictures below one another."""
    whole = Image.new("RGB", (parts[0].width, sum(part.height for part in parts)), "white")
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height
    return np.asarray(whole)
