"""Two summaries of episodes beside one another, headed by the parameters in which they differ.

Pages show them at half their size, so that letters are twice as large as those of the summaries.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.foundations.drawing import INK_RGB, font, wrapped
from sada_gym.foundations.frames import Frame
from sada_gym.parameters import ParameterSpace

LINE, TITLE, HEAD = 34, 25, 150
"""Pixels: a line above a picture, its letters, and the height of a summary's own text."""


def differing(space: ParameterSpace, left: np.ndarray, right: np.ndarray) -> tuple[str, str]:
    """Write the parameters in which two mu differ, with the values of each."""
    pairs = zip(space, space.physical(left), space.physical(right), strict=True)
    lines = [(one.text(a), one.text(b)) for one, a, b in pairs if one.text(a) != one.text(b)]
    first, second = (", ".join(texts) for texts in zip(*lines, strict=True))
    return first, second


def headed(frame: Frame, lines: list[str], count: int) -> Frame:
    """Write `count` lines in place of a summary's text."""
    strip = Image.new("RGB", (frame.shape[1], count * LINE + 8), "white")
    draw, face = ImageDraw.Draw(strip), font(TITLE, bold=True)
    for i, line in enumerate(lines):
        draw.text((6, 4 + i * LINE), line, fill=INK_RGB, font=face)
    return np.vstack([np.asarray(strip), frame[HEAD:]])


def save(frames: list[Frame], texts: tuple[str, str], path: Path) -> None:
    """Write both as one PNG file."""
    face, width = font(TITLE, bold=True), frames[0].shape[1] - 2 * TITLE
    lines = [wrapped(text, face, width) for text in texts]
    count = max(map(len, lines))
    both = [headed(frame, some, count) for frame, some in zip(frames, lines, strict=True)]
    Image.fromarray(np.hstack(both)).save(path, optimize=True)
