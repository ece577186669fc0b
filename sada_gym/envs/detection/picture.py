"""A frame for people: the picture enlarged, the true box, the detections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from sada_gym.envs.detection.scene import Rendering

SIDE = 384
"""Pixels a side of the annotated frame, at least."""

TRUTH, HIT, OTHER = (255, 255, 255), (60, 220, 90), (255, 90, 70)


def annotate(
    rendering: Rendering,
    detections: Mapping[str, npt.NDArray[Any]],
    names: Mapping[int, str],
    target: int,
    floor: float = 0.1,
) -> npt.NDArray[np.uint8]:
    """Draw the true box (white), the target's detections (green) and others (red).

    Args:
        rendering: The frame and its ground truth.
        detections: `boxes` (N, 4), `labels` (N,), `scores` (N,), best first.
        names: Class names by label.
        target: The label that counts.
        floor: Detections with a lower score are left out.

    Returns:
        (side, side, 3) uint8.
    """
    scale = -(-SIDE // len(rendering.image))
    side = scale * len(rendering.image)
    picture = Image.fromarray(rendering.image).resize((side, side), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(picture)
    if rendering.box is not None:
        draw.rectangle((scale * rendering.box).tolist(), outline=TRUTH)
    shown = zip(detections["boxes"], detections["labels"], detections["scores"], strict=True)
    for box, label, score in shown:
        if score < floor:
            continue
        colour = HIT if label == target else OTHER
        corners = np.clip(scale * box, 0, side - 1)
        if (corners[2:] <= corners[:2]).any():
            continue
        draw.rectangle(corners.tolist(), outline=colour, width=2)
        text = f"{names.get(int(label), f'label {label}')} {score:.2f}"
        x, y = corners[0] + 4, max(0.0, corners[1] - 14)
        draw.rectangle(draw.textbbox((x, y), text), fill=(0, 0, 0))
        draw.text((x, y), text, fill=colour)
    return np.asarray(picture)
