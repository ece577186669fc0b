"""A frame for people: the picture enlarged, the true box, the detections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym.envs.detection.detector import Detections
from sada_gym.envs.detection.renderers import Rendering
from sada_gym.foundations.drawing import INK_RGB, dashed, dashed_box, font
from sada_gym.foundations.frames import ORANGE, SKY, Frame, LegendEntry, rgb

SIDE = 384
"""Pixels a side of the annotated frame, at least."""

FLOOR = 0.1
"""Detections with a lower score are left out."""

_TRUTH, _TARGET, _OTHER = "#ffffff", SKY, ORANGE
_EDGE = (0, 0, 0)
_DASHES = {_TRUTH: (4.0, 3.0), _TARGET: (1.0, 0.0), _OTHER: (1.0, 1.0)}
"""The lengths of dashes and gaps in widths of the line."""


def legend(object_class: str) -> tuple[LegendEntry, ...]:
    """Say what the boxes in a frame of an object's class are."""
    return (
        LegendEntry(f"the true {object_class}", _TRUTH, "dashed box"),
        LegendEntry(f"the best detection of a {object_class}", _TARGET, "box"),
        LegendEntry("the best detection of another class", _OTHER, "dotted box"),
        LegendEntry(
            f"Beside a detection stands its confidence; that in a {object_class} is the score Q."
        ),
    )


def annotate(
    rendering: Rendering,
    detections: Detections,
    names: Mapping[int, str],
    target: int,
    finer: Frame | None = None,
) -> npt.NDArray[np.uint8]:
    """Draw the true box, and the best detections of the class and of others, see `legend`.

    `names` are those of the labels; `target` is the label that counts; `finer` is a larger picture
    of the same scene, if there is one.
    """
    scale = -(-SIDE // len(rendering.image))
    side = scale * len(rendering.image)
    seen = rendering.image if finer is None else finer
    picture = Image.fromarray(seen).resize((side, side), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(picture)
    y, line = side // 64, side // 13
    is_target, clear = detections["labels"] == target, detections["scores"] >= FLOOR
    for colour, chosen in ((_TARGET, is_target & clear), (_OTHER, ~is_target & clear)):
        label, text = target, f"below {FLOOR:g}"
        if chosen.any():
            best = int(chosen.argmax())
            _box(draw, scale * detections["boxes"][best], colour, side)
            label, text = int(detections["labels"][best]), f"{detections['scores'][best]:.2f}"
        elif colour == _OTHER:
            continue
        _write(draw, f"{names.get(label, f'label {label}')} {text}", y, colour, side)
        y += line
    if rendering.box is not None:  # on top: its gaps show a detection that is in the same place
        _box(draw, scale * rendering.box, _TRUTH, side)
    return np.asarray(picture)


def _box(draw: ImageDraw.ImageDraw, box: npt.NDArray[Any], colour: str, side: int) -> None:
    x0, y0, x1, y1 = np.clip(box, 0, side - 1).tolist()
    if x0 < x1 and y0 < y1:
        # the target's is wider: it shows beside another detection in the same place
        width = max(2, side // 128) * (2 if colour == _TARGET else 1)
        dash, gap = (width * length for length in _DASHES[colour])
        dashed_box(draw, (x0, y0, x1, y1), rgb(colour), width, dash, gap, casing=_EDGE)


def _write(draw: ImageDraw.ImageDraw, text: str, y: int, colour: str, side: int) -> None:
    left, start, width = side // 64, side // 10, max(2, side // 96)
    face, middle = font(side / 17), y + side / 28
    dash, gap = (width * length for length in _DASHES[colour])
    ends, x = [(left, middle), (start, middle)], start + side // 64
    half, right = side / 26, x + face.getlength(text) + side // 64
    draw.rectangle((0, middle - half, right, middle + half), INK_RGB)  # text shows on any picture
    dashed(draw, ends, rgb(colour), width, dash, gap)
    draw.text((x, middle), text, rgb(colour), face, anchor="lm")
