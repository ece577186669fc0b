"""Images for people: enlarged, and side by side with what the classifier takes them for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

SIDE = 160
"""Pixels a side of an enlarged image, at least."""

RIGHT, WRONG, INK, PAPER = (20, 110, 50), (178, 24, 43), (31, 41, 51), (255, 255, 255)
_GAP, _CAPTION = 8, 42


def enlarged(image: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Draw an image (height, width) in [0, 1] with large square pixels: (h, w, 3) uint8."""
    factor = max(1, -(-SIDE // max(image.shape)))
    grey = np.rint(255.0 * image.astype(np.float64)).astype(np.uint8)
    large = grey.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(large[..., None], 3, axis=2)


def beside(
    images: npt.NDArray[np.float32], probabilities: npt.NDArray[np.float64], label: int
) -> npt.NDArray[np.uint8]:
    """Draw an unchanged image and the changed one side by side, with captions.

    Args:
        images: (2, height, width) in [0, 1].
        probabilities: (2, K), what the classifier says of each.
        label: The true class.

    Returns:
        (h, w, 3) uint8.
    """
    panels = [enlarged(image) for image in images]
    height, width = panels[0].shape[:2]
    width = max(width, SIDE)  # room for the caption
    size = (2 * width + 3 * _GAP, height + _CAPTION + _GAP)
    picture = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(14)
    for i, (title, panel) in enumerate(zip(("unchanged", "attacked"), panels, strict=True)):
        left = _GAP + i * (width + _GAP)
        guess = int(probabilities[i].argmax())
        draw.text((left, 3), title, fill=INK, font=font)
        said = f"seen as {guess}; p({label}) = {probabilities[i, label]:.2f}"
        draw.text((left, 21), said, fill=RIGHT if guess == label else WRONG, font=font)
        picture.paste(Image.fromarray(panel), (left, _CAPTION))
    return np.asarray(picture)
