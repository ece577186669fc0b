"""Names beside the points of a picture, so that none lies over another or over a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation, Text

_RADII = (7, 12, 18, 26, 36, 48, 62, 78, 96, 116, 140)
# diagonals first: error bars lie along the axes
_ALL_ROUND = tuple(np.pi / 8 * np.array([2, 6, 14, 10, 1, 7, 15, 9, 3, 5, 13, 11, 0, 8, 4, 12]))
_LEADER_FROM = 9
_MARGIN = 1.5


def place_labels(
    axes: Axes,
    points: npt.NDArray[np.float64],
    names: Sequence[str],
    colours: Sequence[str],
    *,
    size: float = 8.5,
) -> list[Annotation]:
    """Write a name beside each point, the nearer the better; far ones get a thin line.

    The figure is laid out before and keeps its layout: call it last.

    Args:
        axes: The axes that the points are drawn in.
        points: (n, 2) in data coordinates.
        names: The n names.
        colours: The names' n colours.
        size: The font's size in points.

    Returns:
        The names, in the order of the points.
    """
    pixel = _freeze(axes)
    anchors = axes.transData.transform(points)
    frame = np.array(axes.get_window_extent().extents)
    dots = np.concatenate([anchors - 4 * pixel, anchors + 4 * pixel], axis=1)
    from matplotlib.patheffects import Normal, Stroke

    taken: list[npt.NDArray[np.float64]] = []
    placed: dict[int, Annotation] = {}
    for i in map(int, _crowded(anchors)):
        label = axes.annotate(
            names[i],
            points[i],
            xytext=(0, 0),
            textcoords="offset points",
            fontsize=size,
            color=colours[i],
            ha="center",
            va="center",
            annotation_clip=False,
            zorder=5,
            path_effects=[Stroke(linewidth=2.5, foreground="white"), Normal()],
        )
        extent = label.get_window_extent()
        half = np.array([extent.width, extent.height]) / 2 + _MARGIN * pixel
        offset, box = _best_place(anchors[i], half, frame, [*taken, *dots], pixel)
        taken.append(box)
        label.set_position(cast("tuple[float, float]", tuple(offset / pixel)))
        edge = np.maximum(np.abs(offset) - half, 0.0)
        if np.linalg.norm(edge) > _LEADER_FROM * pixel:
            end = anchors[i] + np.sign(offset) * np.maximum(np.abs(offset) - half, 0.0)
            _draw_leader(axes, anchors[i], end, colours[i])
        placed[i] = label
    return [placed[i] for i in range(len(points))]


def _crowded(anchors: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """Order points by the distances to their nearest ones: the most crowded first."""
    gaps = np.sort(np.linalg.norm(anchors[:, None] - anchors, axis=2), axis=1)
    return np.argsort(gaps[:, :4].sum(axis=1), kind="stable")


def _best_place(
    anchor: npt.NDArray[np.float64],
    half: npt.NDArray[np.float64],
    frame: npt.NDArray[np.float64],
    taken: Sequence[npt.NDArray[np.float64]],
    pixel: float,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Give the offset of a label's centre and its box: free of others, near the point, inside."""
    others = np.array(taken)
    best: tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None
    for radius in _RADII:
        for angle in _ALL_ROUND:
            direction = np.array([np.cos(angle), np.sin(angle)])
            offset = direction * radius * pixel + np.sign(direction.round(6)) * half
            centre = anchor + offset
            box = np.concatenate([centre - half, centre + half])
            overlap = _overlap(box, others).sum() + _outside(box, frame)
            if best is None or overlap < best[0]:
                best = (float(overlap), offset, box)
            if overlap == 0:
                return offset, box
    assert best is not None
    return best[1], best[2]


def _overlap(
    box: npt.NDArray[np.float64], others: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Measure the common area of a box (left, bottom, right, top) with others, (n,)."""
    low = np.maximum(box[:2], others[:, :2])
    high = np.minimum(box[2:], others[:, 2:])
    area: npt.NDArray[np.float64] = np.prod(np.maximum(high - low, 0.0), axis=1)
    return area


def _outside(box: npt.NDArray[np.float64], frame: npt.NDArray[np.float64]) -> float:
    beyond = np.concatenate(
        [np.maximum(frame[:2] - box[:2], 0), np.maximum(box[2:] - frame[2:], 0)]
    )
    return float(beyond.sum()) * 100


def _draw_leader(
    axes: Axes, start: npt.NDArray[np.float64], end: npt.NDArray[np.float64], colour: str
) -> None:
    """Draw a thin line between two places in pixels."""
    line = axes.transData.inverted().transform([start, end])
    axes.plot(
        *line.T, color=(colour, 0.55), linewidth=0.7, scalex=False, scaley=False, clip_on=False
    )


def label_ends(
    axes: Axes,
    ends: npt.NDArray[np.float64],
    names: Sequence[str],
    colours: Sequence[str],
    *,
    size: float = 8.5,
) -> list[Text]:
    """Write the names of lines in a column to the right of the axes, each joined to its line's end.

    The figure is laid out before and keeps its layout: call it last, and leave room.

    Args:
        axes: The axes that the lines are drawn in.
        ends: (n, 2) in data coordinates.
        names: The n names.
        colours: The names' n colours.
        size: The font's size in points.

    Returns:
        The names, in the order of the lines.
    """
    pixel = _freeze(axes)
    anchors, frame = axes.transData.transform(ends), axes.get_window_extent()
    heights = _spread(anchors[:, 1], 1.35 * size * pixel, frame.y0, frame.y1)
    to_data = axes.transData.inverted()
    texts = []
    for anchor, height, name, colour in zip(anchors, heights, names, colours, strict=True):
        place = np.array([frame.x1 + 16 * pixel, height])
        _draw_leader(axes, anchor, place - [3 * pixel, 0], colour)
        x, y = to_data.transform(place)
        texts.append(axes.text(x, y, name, fontsize=size, color=colour, va="center"))
    return texts


def _freeze(axes: Axes) -> float:
    """Lay the figure out for good, and give the pixels of a point."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return figure.dpi / 72


def _spread(
    wanted: npt.NDArray[np.float64], gap: float, low: float, high: float
) -> npt.NDArray[np.float64]:
    """Move heights apart, as little as need be: at least a gap between any two, in order."""
    order = np.argsort(wanted, kind="stable")
    blocks: list[list[float]] = []  # of names that touch: their number, the sum of their starts
    for value in wanted[order] - gap * np.arange(len(wanted)):
        blocks.append([1.0, float(value)])
        while len(blocks) > 1 and blocks[-2][1] / blocks[-2][0] > blocks[-1][1] / blocks[-1][0]:
            count, total = blocks.pop()
            blocks[-1] = [blocks[-1][0] + count, blocks[-1][1] + total]
    starts = np.concatenate([np.full(int(count), total / count) for count, total in blocks])
    placed = np.clip(starts, low, max(low, high - gap * (len(wanted) - 1)))
    heights = np.empty(len(wanted))
    heights[order] = placed + gap * np.arange(len(wanted))
    return heights
