"""Pictures of rollouts for people: parts beside and below one another, with lines of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sada_gym.application import Frame

INK = (31, 41, 51)
_BAR = 26


def caption(text: str, width: int) -> Image.Image:
    """Write a line of text."""
    bar = Image.new("RGB", (width, _BAR), "white")
    ImageDraw.Draw(bar).text((8, 4), text, fill=INK, font=ImageFont.load_default(15))
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
