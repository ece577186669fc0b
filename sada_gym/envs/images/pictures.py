"""Pictures of images under conditions: what counts in them, and what the model told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.foundations.arrays import Bools, Bytes, Floats
from sada_gym.foundations.drawing import dashed_box, font, wrapped
from sada_gym.foundations.frames import INK, ORANGE, SKY, VERMILLION, Frame, LegendEntry, rgb

SIZE = 480, 360
"""Width and height in px of a panel, which an image fills in one direction."""

_BELOW, _LETTERS = 90, (36, 26, 18)
_FOUND, _MISSED, _TOLD = SKY, VERMILLION, ORANGE

LEGENDS = {
    "detect": (
        LegendEntry("an object that was found", _FOUND, "box"),
        LegendEntry("an object that was missed", _MISSED, "dashed box"),
        LegendEntry("what the model told, with its confidence", _TOLD, "dotted box"),
        LegendEntry("Left: the untouched image. Right: the same image in the world."),
    ),
    "classify": (
        LegendEntry(
            "Left: the untouched image. Right: the same image in the world. Below: what it was "
            "taken for, and with which probability."
        ),
    ),
}
"""What the marks in pictures mean, for both kinds of models."""


def fitted(image: Bytes) -> Frame:
    """Return an image scaled into `SIZE`, on white."""
    return np.asarray(_canvas(image)[0])


def drawn(
    image: Bytes, truth: Floats, seen: Bools, told: Floats, texts: Sequence[str], line: str
) -> Image.Image:
    """Draw an image with its objects and the model's answers.

    Args:
        image: (height, width, 3) uint8.
        truth: (n, 4) boxes of what counts in it.
        seen: Which of them were found, (n,), or whether the image was taken for what it is, (1,).
        told: (m, 4) boxes of what the model told.
        texts: What stands beside each of these.
        line: What is written below: in letters that a sheet of failures still shows.
    """
    canvas, scale, corner = _canvas(image)
    draw, face = ImageDraw.Draw(canvas), font(13)
    shift = np.tile(corner, 2)
    for box, text in zip(told * scale + shift, texts, strict=True):
        dashed_box(draw, box.tolist(), rgb(_TOLD), 2, 2.0, 2.0, casing=(0, 0, 0))
        draw.text(
            *((box[0] + 2, box[1] - 16), text),
            *(rgb(_TOLD), face),
            stroke_width=2,
            stroke_fill="black",
        )
    for box, was_found in zip(truth * scale + shift, seen[: len(truth)], strict=True):
        colour, dash = (_FOUND, (1.0, 0.0)) if was_found else (_MISSED, (8.0, 6.0))
        dashed_box(draw, box.tolist(), rgb(colour), 3, *dash, casing=(0, 0, 0))
    whole = Image.new("RGB", (SIZE[0], SIZE[1] + _BELOW), "white")
    whole.paste(canvas, (0, 0))
    ink = rgb(INK if seen.all() else _MISSED)
    fits = [(size, wrapped(line, font(size), SIZE[0] - 12)) for size in _LETTERS]
    size, lines = next((one for one in fits if len(one[1]) <= 2), fits[-1])
    ImageDraw.Draw(whole).text((6, SIZE[1]), "\n".join(lines), fill=ink, font=font(size))
    return whole


def _canvas(image: Bytes) -> tuple[Image.Image, float, Floats]:
    """Return a picture of `SIZE` with an image in its middle, its scale, and where it begins."""
    rows, columns = image.shape[:2]
    scale = min(SIZE[0] / columns, SIZE[1] / rows)
    size = max(1, round(columns * scale)), max(1, round(rows * scale))
    small = Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)
    corner = (SIZE[0] - size[0]) // 2, (SIZE[1] - size[1]) // 2
    canvas = Image.new("RGB", SIZE, "white")
    canvas.paste(small, corner)
    return canvas, scale, np.array(corner, np.float64)
