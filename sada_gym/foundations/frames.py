"""Frames, their colours, and what the marks in them mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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


_ROUNDED = 1e-3
"""How far floats may be off by rounding."""


class LegendEntry(NamedTuple):
    """What a mark in an application's frames means: its text, its colour `#rrggbb`, its `Mark`."""

    text: str
    colour: str = INK
    mark: Mark = "note"


@dataclass(frozen=True)
class Take:
    """One episode, played again, as a film shows it.

    Attributes:
        count: How many pictures it has, `Application.render_fps` a second.
        draw: Draws one of them, by its number, and says in a line what it shows.
        ending: How it ends, such as `hit the frame of gate 4`; `failed` says whether the agent did.
    """

    count: int
    draw: Callable[[int], tuple[Frame, str]]
    ending: str
    failed: bool


def as_frame(given: Any, source: str) -> Frame:
    """Return what a source such as `MyApplication.render` drew as an RGB image.

    Whole numbers go from 0 to 255; floats do, too, or from 0 to 1. Booleans are black and white,
    one channel is grey, and alpha lies over white.

    Raises:
        UserError: If it is no picture.
    """
    try:
        frame = np.asarray(given)
    except ValueError:  # a list of frames of different sizes
        frame = np.empty(len(given), object)
    kind, shape = frame.dtype, frame.shape
    frame = frame[..., None] if frame.ndim == 2 else frame
    channels = frame.shape[2] if frame.ndim == 3 and frame.size else 0
    if kind.kind not in "buif" or channels not in (1, 3, 4):
        came = f"{type(given).__name__} of shape {shape} and type {kind}"
    elif not -_ROUNDED <= frame.min() <= frame.max() <= 255 + _ROUNDED:
        came = f"values from {frame.min():g} to {frame.max():g}"
    else:
        if kind.kind in "bf" and frame.max() <= 1 + _ROUNDED:
            frame = frame * np.float64(255)
        if kind != np.uint8:
            frame = np.rint(np.clip(frame, 0, 255)).astype(np.uint8)
        if channels == 4:
            opaque = frame[..., 3:] / 255.0
            frame = np.rint(frame[..., :3] * opaque + 255 * (1 - opaque)).astype(np.uint8)
        return np.repeat(frame, 3, axis=2) if channels == 1 else frame
    raise UserError(
        f"Expected a frame of shape (height, width, 3) and type uint8, got {came}. Fix {source}."
    )


def rgb(colour: str) -> Colour:
    """Return the red, green and blue, 0 to 255, of a colour such as `#d55e00`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
