"""Warps of grey images: stroke, shear, scale, rotation, shift, contrast. Neutral ones are exact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sada_gym.foundations.arrays import Floats, Floats32, Indices

Images = Floats32  # (n, height, width) in [0, 1]
Values = Floats  # (n, height, width)
Column = Floats  # (n,), a number for each image


@dataclass(frozen=True, eq=False)
class Warps:
    """How n images are changed; 0, 1, 0, 0, 1, 0 changes nothing, to the last bit."""

    rotation_deg: Column  # turns the digit counterclockwise
    scale: Column  # enlarges it about the image's centre
    shear: Column  # moves a pixel to the right by this times its height over the centre
    shift_px: Column  # moves the digit to the right
    contrast: Column  # multiplies the distance from the middle grey, 0.5; [0, 1] is not left
    stroke: Column  # from -1, thin, to 1, thick; see `Strokes`


class Strokes:
    """Images (n, height, width) in [0, 1] whose strokes are drawn thinner or thicker.

    The thickest lifts each pixel half way to the greatest value among itself and its four
    neighbours: strokes gain about half a pixel on either side. The thinnest keeps a pixel that is
    the greatest among these, blackens one of at most half of it, and scales linearly in between:
    the ridge of a stroke stays and its flanks fade. Others are blends with the image as it is.
    """

    def __init__(self, images: Images) -> None:
        self._images = images.astype(np.float64)
        padded = np.pad(self._images, ((0, 0), (1, 1), (1, 1)))
        neighbours = [padded[:, :-2, 1:-1], padded[:, 2:, 1:-1]]
        neighbours += [padded[:, 1:-1, :-2], padded[:, 1:-1, 2:]]
        greatest = np.maximum.reduce([self._images, *neighbours])
        share = np.divide(self._images, greatest, out=np.ones_like(greatest), where=greatest > 0)
        self._thick = 0.5 * (greatest - self._images)
        self._thin = self._images * np.maximum(2.0 * share - 1.0, 0.0) - self._images

    def __call__(self, rows: Indices, stroke: Column) -> Values:
        """Return the images at rows (n,) with strokes (n,) from -1 to 1: (n, height, width)."""
        amount = stroke[:, None, None]
        change: Values = np.maximum(amount, 0.0) * self._thick[rows]
        change += np.maximum(-amount, 0.0) * self._thin[rows]
        return self._images[rows] + change


def warp(strokes: Strokes, rows: Indices, warps: Warps) -> Images:
    """Warp the images at rows (n,) bilinearly; what comes from beyond an image's border is 0.

    Returns:
        (n, height, width) float32 in [0, 1].
    """
    drawn = strokes(rows, warps.stroke)
    moved = _sample(drawn, *_sources(drawn.shape[1], drawn.shape[2], warps))
    # x + (c - 1)(x - 0.5), not 0.5 + c (x - 0.5): exact where c = 1
    contrast = (warps.contrast - 1.0)[:, None, None]
    return np.clip(moved + contrast * (moved - 0.5), 0.0, 1.0).astype(np.float32)


def _sources(height: int, width: int, warps: Warps) -> tuple[Values, Values]:
    """Find where each pixel of warped images comes from: rows and columns, (n, height, width)."""
    # math's sines, one by one: NumPy's may differ in the last bit with the batch's size
    radians = [math.radians(degrees) for degrees in warps.rotation_deg.tolist()]
    cosine = np.array([math.cos(angle) for angle in radians])[:, None, None]
    sine = np.array([math.sin(angle) for angle in radians])[:, None, None]
    middle_y, middle_x = (height - 1) / 2, (width - 1) / 2
    y = np.arange(height)[None, :, None] - middle_y  # downwards
    x = np.arange(width)[None, None, :] - middle_x - warps.shift_px[:, None, None]
    scale = warps.scale[:, None, None]
    turned_x, turned_y = (cosine * x - sine * y) / scale, (sine * x + cosine * y) / scale
    slant = warps.shear[:, None, None] * turned_y
    return turned_y + middle_y, turned_x + slant + middle_x


def _sample(images: Values, y: Values, x: Values) -> Values:
    """Interpolate images (n, height, width) bilinearly at y and x; 0 beyond the border."""
    count, height, width = images.shape
    padded = np.pad(images, ((0, 0), (1, 2), (1, 2))).ravel()
    y, x = np.clip(y + 1.0, 0.0, height + 1.0), np.clip(x + 1.0, 0.0, width + 1.0)
    top, left = y.astype(np.int64), x.astype(np.int64)
    below, right = y - top, x - left
    stride = width + 3
    first = np.arange(count)[:, None, None] * ((height + 3) * stride) + top * stride + left
    upper: Values = padded[first] * (1.0 - right) + padded[first + 1] * right
    lower: Values = padded[first + stride] * (1.0 - right) + padded[first + stride + 1] * right
    return upper * (1.0 - below) + lower * below
