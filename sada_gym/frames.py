"""Frames, their colours, and what the marks in them mean."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError

Frame = npt.NDArray[np.uint8]
"""An RGB image, (height, width, 3) uint8."""

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILLION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"
"""The palette of Okabe and Ito (2008, "Color Universal Design"), made for the colour-blind."""

INK, MUTED, GRID = "#1f2933", "#5b6673", "#e4e8ec"

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
    """A mark in an application's frames, its colour as `#rrggbb`, and what it means."""

    text: str
    colour: str = INK
    mark: Mark = "note"


def validate_frame(given: Any, source: str) -> Frame:
    """Return what a source such as `MyApplication.render` drew, if it is a frame.

    Raises:
        UserError: If it is no frame.
    """
    frame = np.asarray(given)
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or not frame.size:
        raise UserError(
            f"Expected a frame of shape (height, width, 3) and type uint8, got {frame.shape} and "
            f"{frame.dtype}. Mend {source}."
        )
    return frame


def rgb(colour: str) -> Colour:
    """Return the red, green and blue, 0 to 255, of a colour such as `#d55e00`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
