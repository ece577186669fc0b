"""A frame for people: the picture enlarged, the true box, the detections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from sada_gym.envs.detection.renderers import Rendering

SIDE = 384
"""Pixels a side of the annotated frame, at least."""

TRUTH, HIT, OTHER = (255, 255, 255), (70, 230, 100), (255, 110, 90)
FLOOR = 0.1
"""Detections with a lower score are left out."""


def annotate(
    rendering: Rendering,
    detections: Mapping[str, npt.NDArray[Any]],
    names: Mapping[int, str],
    target: int,
) -> npt.NDArray[np.uint8]:
    """Draw the true box (white), the best detection of the class (green) and of others (red).

    Args:
        rendering: The frame and its ground truth.
        detections: `boxes` (N, 4), `labels` (N,), `scores` (N,), best first.
        names: Class names by label.
        target: The label that counts.

    Returns:
        (side, side, 3) uint8.
    """
    scale = -(-SIDE // len(rendering.image))
    side = scale * len(rendering.image)
    picture = Image.fromarray(rendering.image).resize((side, side), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(side // 18)
    if rendering.box is not None:
        draw.rectangle((scale * rendering.box).tolist(), outline=TRUTH)
    y = side // 64
    for colour, chosen in (
        (HIT, detections["labels"] == target),
        (OTHER, detections["labels"] != target),
    ):
        chosen = np.flatnonzero(chosen & (detections["scores"] >= FLOOR))[:1]
        for i in chosen:
            x0, y0, x1, y1 = np.clip(scale * detections["boxes"][i], 0, side - 1).tolist()
            if x0 < x1 and y0 < y1:
                draw.rectangle((x0, y0, x1, y1), outline=colour, width=2)
            label = int(detections["labels"][i])
            text = f"{names.get(label, f'label {label}')} {detections['scores'][i]:.2f}"
            draw.text((side // 64, y), text, fill=colour, font=font, stroke_width=2, stroke_fill=0)
            y += side // 14
    return np.asarray(picture)
