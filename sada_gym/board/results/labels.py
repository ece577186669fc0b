"""Names beside the points of a picture, so that none lies over another or over a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.optimize import isotonic_regression

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

Values = npt.NDArray[np.float64]

_RADII = (9, 16, 25, 36, 50, 66, 86, 108, 133, 160, 195)
# diagonals first: error bars lie along the axes
_ALL_ROUND = np.pi / 8 * np.array([2, 6, 14, 10, 1, 7, 15, 9, 3, 5, 13, 11, 0, 8, 4, 12])
_DOT = 6.0  # half the side of the square that a point takes
_MARGIN = 2.0
_SIZE = 8.5  # of the names of lines, in points


def place_labels(
    anchors: Values, sizes: Values, frame: tuple[float, float, float, float]
) -> Values:
    """Find a place for the name of each point: free of others, the nearer the better.

    Args:
        anchors: (n, 2), the points in pixels.
        sizes: (n, 2), the widths and heights of the names in pixels.
        frame: The left, top, right and bottom within which the names have to be.

    Returns:
        (n, 2), the middles of the names in pixels.
    """
    edges, dots = np.array(frame), np.concatenate([anchors - _DOT, anchors + _DOT], axis=1)
    taken: list[Values] = []
    middles = np.empty_like(anchors, np.float64)
    for i in map(int, _crowded(anchors)):
        half = sizes[i] / 2 + _MARGIN
        middles[i], box = _best_place(anchors[i], half, edges, np.array([*taken, *dots]))
        taken.append(box)
    return middles


def _crowded(anchors: Values) -> npt.NDArray[np.intp]:
    """Order points by the distances to their nearest ones: the most crowded first."""
    gaps = np.sort(np.linalg.norm(anchors[:, None] - anchors, axis=2), axis=1)
    return np.argsort(gaps[:, :4].sum(axis=1), kind="stable")


def _best_place(
    anchor: Values, half: Values, frame: Values, taken: Values
) -> tuple[Values, Values]:
    """Return a label's middle and its box: free of others, near the point, inside."""
    directions = np.stack([np.cos(_ALL_ROUND), np.sin(_ALL_ROUND)], axis=1)
    offsets = directions * np.array(_RADII)[:, None, None] + np.sign(directions.round(6)) * half
    middles = anchor + offsets.reshape(-1, 2)
    low, high = middles - half, middles + half
    sides = np.minimum(high[:, None], taken[:, 2:]) - np.maximum(low[:, None], taken[:, :2])
    overlap = np.prod(np.maximum(sides, 0.0), axis=2).sum(axis=1)
    outside = np.maximum(frame[:2] - low, 0.0) + np.maximum(high - frame[2:], 0.0)
    best = np.argmin(overlap + 100 * outside.sum(axis=1))  # the first of equal ones
    return middles[best], np.concatenate([low[best], high[best]])


def _draw_leader(axes: Axes, start: Values, end: Values, colour: str) -> None:
    """Draw a thin line between two places in pixels."""
    line = axes.transData.inverted().transform([start, end])
    axes.plot(
        *line.T, color=(colour, 0.55), linewidth=0.7, scalex=False, scaley=False, clip_on=False
    )


def label_ends(
    axes: Axes, ends: Values, names: Sequence[str], colours: Sequence[str]
) -> list[Text]:
    """Write the names of lines in a column to the right of the axes, each joined to its line's end.

    The figure is laid out before and keeps its layout: call it last, and leave room.

    Args:
        axes: The axes that the lines are drawn in.
        ends: (n, 2) in data coordinates.
        names: The n names.
        colours: The names' n colours.

    Returns:
        The names, in the order of the lines.
    """
    pixel = _freeze(axes)
    anchors, frame = axes.transData.transform(ends), axes.get_window_extent()
    heights = _spread(anchors[:, 1], 1.35 * _SIZE * pixel, frame.y0, frame.y1)
    to_data = axes.transData.inverted()
    texts = []
    for anchor, height, name, colour in zip(anchors, heights, names, colours, strict=True):
        place = np.array([frame.x1 + 16 * pixel, height])
        _draw_leader(axes, anchor, place - [3 * pixel, 0], colour)
        x, y = to_data.transform(place)
        texts.append(axes.text(x, y, name, fontsize=_SIZE, color=colour, va="center"))
    return texts


def _freeze(axes: Axes) -> float:
    """Lay the figure out for good, and give the pixels of a point."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return figure.dpi / 72


def _spread(wanted: Values, gap: float, low: float, high: float) -> Values:
    """Move heights apart, as little as need be: at least a gap between any two, in order."""
    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(wanted))
    starts = isotonic_regression(wanted[order] - steps).x
    placed = np.clip(starts, low, max(low, high - gap * (len(wanted) - 1)))
    heights = np.empty(len(wanted))
    heights[order] = placed + steps
    return heights
