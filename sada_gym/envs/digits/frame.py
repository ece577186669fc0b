"""Images for people: enlarged, and side by side with what the classifier takes them for."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from sada_gym.foundations.arrays import Bytes, Floats, Floats32
from sada_gym.foundations.drawing import dashed, font
from sada_gym.foundations.frames import GREEN, VERMILLION, LegendEntry, rgb

SIDE = 160
"""Pixels a side of an enlarged image, at least."""

RIGHT, WRONG, INK, PAPER = rgb(GREEN), rgb(VERMILLION), (31, 41, 51), (255, 255, 255)
_GAP, _LINE, _CAPTION = 8, 23, 80

LEGEND = (
    LegendEntry("seen as the class that it is", GREEN, "line"),
    LegendEntry("seen as another class", VERMILLION, "dashed line"),
    LegendEntry(
        "Left: the image. Right: what the adversary made of it. p is the classifier's "
        "probability of the true class, which stands in brackets."
    ),
)


def enlarged(image: Floats32) -> Bytes:
    """Draw an image (height, width) in [0, 1] with large square pixels: (h, w, 3) uint8."""
    factor = max(1, -(-SIDE // max(image.shape)))
    grey = np.rint(255.0 * image.astype(np.float64)).astype(np.uint8)
    large = grey.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(large[..., None], 3, axis=2)


def beside(images: Floats32, probabilities: Floats, label: int) -> Bytes:
    """Draw an unchanged image and the changed one side by side, with captions.

    Images are (2, height, width) in [0, 1], with probabilities (2, K); `label` is the true class.
    """
    panels = [enlarged(image) for image in images]
    height, width = panels[0].shape[:2]
    width = max(width, SIDE)  # room for the caption
    picture = Image.new("RGB", (2 * width + 3 * _GAP, height + _CAPTION + _GAP), PAPER)
    draw, face = ImageDraw.Draw(picture), font(20)
    for i, (title, panel) in enumerate(zip(("unchanged", "attacked"), panels, strict=True)):
        left = _GAP + i * (width + _GAP)
        guess = int(probabilities[i].argmax())
        right = guess == label
        lines = (title, f"seen as {guess}", f"p({label}) = {probabilities[i, label]:.2f}")
        for k, line in enumerate(lines):
            draw.text((left, 2 + k * _LINE), line, fill=INK, font=face)
        ends = [(left, _CAPTION - 3), (left + panel.shape[1], _CAPTION - 3)]
        dashed(draw, ends, RIGHT if right else WRONG, 5, 14, 0 if right else 8)
        picture.paste(Image.fromarray(panel), (left, _CAPTION))
    return np.asarray(picture)
