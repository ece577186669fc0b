"""Two summaries of episodes beside one another, headed by the parameters in which they differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.foundations.drawing import INK_RGB, font
from sada_gym.foundations.frames import Frame
from sada_gym.parameters import ParameterSpace

LINE, TITLE, HEAD = 30, 17, 150
"""Pixels: a line of a summary's text, its letters, and the text's height."""


def differing(space: ParameterSpace, left: np.ndarray, right: np.ndarray) -> tuple[str, str]:
    """Write the parameters in which two mu differ, with the values of each."""
    pairs = zip(space, space.physical(left), space.physical(right), strict=True)
    lines = [(one.text(a), one.text(b)) for one, a, b in pairs if one.text(a) != one.text(b)]
    first, second = (", ".join(texts) for texts in zip(*lines, strict=True))
    return first, second


def headed(frame: Frame, text: str) -> Frame:
    """Keep a summary's first line, and write a text in place of all parameters."""
    strip = Image.new("RGB", (frame.shape[1], LINE + 8), "white")
    ImageDraw.Draw(strip).text((6, 4), text, fill=INK_RGB, font=font(TITLE, bold=True))
    return np.vstack([frame[:LINE], np.asarray(strip), frame[HEAD:]])


def save(frames: list[Frame], texts: tuple[str, str], path: Path) -> None:
    """Write both as one PNG file."""
    both = [headed(frame, text) for frame, text in zip(frames, texts, strict=True)]
    Image.fromarray(np.hstack(both)).save(path, optimize=True)
