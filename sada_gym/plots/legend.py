"""What the lines and marks in an application's frames mean."""

from __future__ import annotations

from typing import Literal, NamedTuple

from PIL import ImageDraw

from sada_gym.plots.frames import Colour, dashed, rgb
from sada_gym.plots.style import INK

Mark = Literal[
    "note",
    "area",
    "box",
    "dashed box",
    "dotted box",
    "line",
    "dashed line",
    "dotted line",
    "dots",
    "disc",
    "square",
    "cross",
    "plus",
    "arrow",
]
"""How an entry's mark is drawn. A `note` is a line of text without a mark."""


class LegendEntry(NamedTuple):
    """A mark in an application's frames and what it means.

    Attributes:
        text: What it means, such as `the true box`.
        colour: Its colour as `#rrggbb`.
        mark: How it is drawn.
    """

    text: str
    colour: str = INK
    mark: Mark = "note"


def swatch(draw: ImageDraw.ImageDraw, entry: LegendEntry, box: tuple[int, int, int, int]) -> None:
    """Draw an entry's mark.

    Args:
        draw: Draws on the picture.
        entry: The entry.
        box: The mark's place: left, top, right and bottom in pixels.
    """
    left, top, right, bottom = box
    x, y, r = (left + right) / 2, (top + bottom) / 2, (bottom - top) / 2
    width = max(2, round(r / 4))
    colour = rgb(entry.colour)
    kind, _, shape = entry.mark.rpartition(" ")
    gaps = {"": (1.0, 0.0), "dashed": (2.5, 1.8), "dotted": (1.0, 1.0)}[kind]
    dash, gap = gaps[0] * width, gaps[1] * width
    corners: list[tuple[float, float]] = [
        (left, top),
        (right, top),
        (right, bottom),
        (left, bottom),
        (left, top),
    ]
    if shape == "area":
        draw.rectangle(box, colour, rgb(INK))
    elif shape == "box":
        _cased(draw, corners, colour, width, dash, gap)
    elif shape == "line":
        _cased(draw, [(left, y), (right, y)], colour, 2 * width, dash * 2, gap * 2)
    elif shape == "dots":
        for offset in (-1.2, 0.0, 1.2):
            draw.circle((x + offset * r, y), 0.3 * r, colour)
    elif shape == "disc":
        draw.circle((x, y), 0.8 * r, colour, rgb(INK), max(1, width // 2))
    elif shape == "square":
        draw.rectangle((x - 0.8 * r, y - 0.8 * r, x + 0.8 * r, y + 0.8 * r), colour, rgb(INK))
    elif shape in ("cross", "plus"):
        arm = 0.8 * r
        ends = [(-arm, -arm, arm, arm), (-arm, arm, arm, -arm)]
        if shape == "plus":
            ends = [(-arm, 0.0, arm, 0.0), (0.0, -arm, 0.0, arm)]
        for x0, y0, x1, y1 in ends:
            draw.line([(x + x0, y + y0), (x + x1, y + y1)], colour, round(1.6 * width))
    elif shape == "arrow":
        draw.polygon([(x + r, y), (x - 0.8 * r, y - 0.8 * r), (x - 0.8 * r, y + 0.8 * r)], colour)


def _cased(
    draw: ImageDraw.ImageDraw,
    points: list[tuple[float, float]],
    colour: Colour,
    width: int,
    dash: float,
    gap: float,
) -> None:
    """Draw a line with a dark edge, so that a white one shows on white."""
    dashed(draw, points, colour, width, dash, gap, casing=(64, 72, 80))
