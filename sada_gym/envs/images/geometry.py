"""Conditions that move what is in an image: rotation, zoom and the lens's distortion.

Points are (n, 2), x to the right and y downwards, from the image's middle, in halves of its longer
side: the same for images of any size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from sada_gym.foundations.arrays import Bytes, Floats

Move = Callable[[Floats], Floats]
"""Says where points go."""

_STEP = 8
"""Between these pixels the map of an image is linear, which is off by less than a tenth of one."""
_CORNER, _RADII = 2.0**0.5, 1_001
_GREY = 114
_POINTS = 9
"""Points along each side of a box that are moved with an image."""


def rotated(points: Floats, degrees: float) -> Floats:
    """Turn points clockwise."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned: Floats = points @ turn
    return turned


def spread(points: Floats, k1: float) -> Floats:
    """Move points outwards by Brown's first radial coefficient; inwards below 0."""
    spread: Floats = points * (1.0 + k1 * (points**2).sum(axis=1, keepdims=True))
    return spread


def gathered(points: Floats, k1: float) -> Floats:
    """Invert `spread`; what comes from outside of a square image stays outside."""
    far = np.sqrt((points**2).sum(axis=1, keepdims=True))
    radii = np.linspace(0.0, _CORNER, _RADII)
    reached = radii * (1.0 + k1 * radii**2)
    inside = np.interp(far, reached, radii) + np.maximum(far - reached[-1], 0.0)
    shares: Floats = np.divide(inside, far, out=np.ones_like(far), where=far > 0.0)
    return points * shares


def composed(moves: Sequence[Move]) -> Move:
    """Make one move after the other."""

    def move(points: Floats) -> Floats:
        for each in moves:
            points = each(points)
        return points

    return move


def origin_of(moves: Sequence[tuple[Move, Move]]) -> Move:
    """Return where the points of an image come from that made several moves."""
    return composed([origin for _, origin in reversed(moves)])


def turning(degrees: float) -> tuple[Move, Move]:
    """Return where points go when an image is turned, and where they come from."""
    return partial(rotated, degrees=degrees), partial(rotated, degrees=-degrees)


def zooming(factor: float) -> tuple[Move, Move]:
    """Return where points go when an image is enlarged, and where they come from."""
    return partial(np.multiply, factor), partial(np.multiply, 1.0 / factor)


def distorting(k1: float) -> tuple[Move, Move]:
    """Return where points go in a lens, and where they come from: a barrel above 0."""
    return partial(gathered, k1=k1), partial(spread, k1=k1)


def warped(image: Bytes, origin: Move) -> Bytes:
    """Draw an image whose points come from those that `origin` says; grey where there are none."""
    import cv2

    rows, columns = image.shape[:2]
    half = 0.5 * max(rows, columns)
    middle = 0.5 * np.array([columns - 1.0, rows - 1.0])
    # `resize` takes pixels for areas, so the coarse map has the cells' middles, one more all around
    cells = [np.arange(-1, -(-count // _STEP) + 1) for count in (columns, rows)]
    x, y = np.meshgrid(*(_STEP * cell + 0.5 * (_STEP - 1) for cell in cells))
    points = (np.stack([x.ravel(), y.ravel()], axis=1) - middle) / half
    coarse = (origin(points) * half + middle).astype(np.float32).reshape(*x.shape, 2)
    fine = cv2.resize(coarse, (_STEP * x.shape[1], _STEP * x.shape[0]))
    inner = fine[_STEP : _STEP + rows, _STEP : _STEP + columns]
    # a mirrored edge would show objects that no label knows
    grey = (_GREY, _GREY, _GREY, 0)
    four = cv2.cvtColor(image, cv2.COLOR_RGB2RGBA)  # moved twice as fast as three channels
    moved = cv2.remap(four, inner, None, cv2.INTER_LINEAR, borderValue=grey)
    result: Bytes = cv2.cvtColor(moved, cv2.COLOR_RGBA2RGB)
    return result


def moved_boxes(boxes: Floats, target: Move, columns: int, rows: int) -> Floats:
    """Return the boxes, (n, 4) x0 y0 x1 y1 in px, around boxes whose points were moved.

    They are not cut at the image's edges.
    """
    half = 0.5 * max(rows, columns)
    middle = 0.5 * np.array([columns, rows], np.float64)
    share = np.linspace(0.0, 1.0, _POINTS)
    ends, sides = np.zeros(_POINTS), np.ones(_POINTS)
    x = np.concatenate([share, share, ends, sides])
    y = np.concatenate([ends, sides, share, share])
    outline = np.stack(
        [
            boxes[:, [0]] * (1.0 - x) + boxes[:, [2]] * x,
            boxes[:, [1]] * (1.0 - y) + boxes[:, [3]] * y,
        ],
        axis=2,
    )
    gone = target(((outline - middle) / half).reshape(-1, 2)).reshape(outline.shape)
    gone = gone * half + middle
    around: Floats = np.concatenate([gone.min(axis=1), gone.max(axis=1)], axis=1)
    return around
