"""The charts of a benchmark: anytime curves, marginals, novelty."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import isotonic_regression

from sada_gym.analyses.plots.style import ACCENT, axis_label, new_figure, places, span, tidy
from sada_gym.board.results.front import FAMILIES, family_of
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from sada_gym.parameters import Mu, ParameterSpace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

MAX_PARAMETERS = 16
"""Parameters in a picture of marginals."""

_BINS = 18
_SIZE = 8.5  # of the names of lines, in points
_CEILING = 4.0  # times uniform, where the marginals' colours end

_DENSITY = ((0.0, "#4a7ab5"), (0.5, "#f7f7f7"), (0.75, "#d1622a"), (1.0, "#5c1a04"))


@dataclass(frozen=True)
class Curve:
    """What a search had found after each number of queries.

    Attributes:
        labels: The adversaries that made these queries.
        queries: (n,) numbers of queries spent.
        found: (n,) numbers of distinct fooling points among them.
        coverage: (n,) shares of the fooling set that they cover; None without a reference set.
    """

    labels: tuple[str, ...]
    queries: Floats
    found: Floats
    coverage: Floats | None


@own_style()
def anytime_curves(curves: Sequence[Curve], title: str) -> Figure:
    """Draw what queries found, and how much of the fooling set this covers, against their number.

    Args:
        curves: A curve for each set of queries.
        title: The line above the chart.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    covered = all(curve.coverage is not None for curve in curves)
    figure = new_figure(12.5 if covered else 7.0, 5.2)
    panels = figure.subplots(1, 2 if covered else 1, squeeze=False)[0]
    names, notes = _short_names(curves)
    colours = [INK if _is_shared(curve) else family_of(curve.labels[0]).colour for curve in curves]
    last = max(float(curve.queries[-1]) for curve in curves)
    ends = []
    for axes, what in zip(panels, ("found", "coverage"), strict=False):
        ends.append(np.zeros((len(curves), 2)))
        for i, (curve, style) in enumerate(zip(curves, _styles(colours), strict=True)):
            values = curve.found if curve.coverage is None or what == "found" else curve.coverage
            look = {"linestyle": style, "linewidth": 1.5, "marker": "o", "markersize": 2.5}
            axes.plot(curve.queries, values, color=colours[i], **look)
            ends[-1][i] = curve.queries[-1], values[-1]
        axes.set_xlim(0, 1.03 * last)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("queries")
        axes.xaxis.set_major_formatter("{x:,.0f}")
        tidy(axes, grid="both")
    panels[0].set_ylabel("distinct fooling points found")
    panels[0].yaxis.set_major_formatter("{x:,.0f}")
    panels[0].yaxis.get_major_locator().set_params(integer=True)
    if covered:
        panels[1].set_ylim(0, min(1.15 * panels[1].dataLim.y1, 1.03))
        panels[1].yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        panels[1].set_ylabel("coverage of the fooling set by these points")
    _families(figure, [curve.labels[0] for curve in curves if not _is_shared(curve)])
    _title(figure, title, "\n".join(notes))
    engine = figure.get_layout_engine()
    assert isinstance(engine, ConstrainedLayoutEngine)
    engine.set(rect=(0, 0, 0.88, 1), wspace=0.24)  # room for the names
    for axes, of_panel in zip(panels, ends, strict=True):
        label_ends(axes, of_panel, names, colours)
    return figure


@own_style()
def marginal_strips(
    space: ParameterSpace, samples: Mapping[str, Mu], fooling_set: Mu | None, title: str
) -> Figure:
    """Draw how the samples of each adversary spread over each parameter, as coloured strips.

    Args:
        space: The d parameters; the first 16 are drawn.
        samples: The samples of each adversary, (n, d).
        fooling_set: Points known to fool, (m, d), drawn as the first strip; None for none.
        title: The line above the chart.
    """
    from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm

    strips = {} if fooling_set is None else {"the fooling set": fooling_set}
    strips |= dict(samples)
    count = min(len(space), MAX_PARAMETERS)
    columns = min(4, count)
    rows = -(-count // columns)
    figure = new_figure(1.9 + 2.6 * columns, (0.19 * len(strips) + 0.75) * rows + 1.0)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    colours = LinearSegmentedColormap.from_list("density", _DENSITY)
    for i, axes in enumerate(grid.flat):
        if i >= count:
            axes.set_visible(False)
            continue
        parameter = space.parameters[i]
        bins = len(parameter.choices) or _BINS
        edges = np.linspace(-1.0, 1.0, bins + 1)
        counts = np.array([np.histogram(mu[:, i], edges)[0] / len(mu) for mu in strips.values()])
        ends = places(parameter, np.array([parameter.low, parameter.high]))
        image = axes.imshow(
            counts * bins,
            aspect="auto",
            cmap=colours,
            norm=TwoSlopeNorm(1.0, 0.0, _CEILING),
            extent=(*ends, len(strips), 0),
            interpolation="nearest",
        )
        for line in range(1, len(strips)):
            under = line == 1 and fooling_set is not None
            axes.axhline(line, color=INK if under else "white", linewidth=1.0)
        axes.set_xlabel(axis_label(parameter))
        axes.set_yticks(np.arange(len(strips)) + 0.5, list(strips))
        tidy(axes)
        span(axes, "x", parameter)
        _hide_left(axes)
    bar = figure.colorbar(image, ax=grid, shrink=0.7, aspect=30, extend="max", pad=0.01)
    bar.set_label("density, times uniform", color=INK, fontsize=9)
    bar.set_ticks([0, 0.5, 1, 2, 3, 4])
    bar.ax.tick_params(colors=MUTED, labelsize=8)
    bar.outline.set_visible(False)
    if count < len(space):
        title += f" (the first {count} of {len(space)} parameters)"
    _title(figure, title)
    return figure


NOVELTY_PANELS = {
    "novelty_ratio": "median distance in μ / ideal's",
    "novelty_fifth_ratio": "fifth percentile in μ / ideal's",
    "image_novelty_ratio": "median distance between images / ideal's",
}
"""What `novelty_ratios` draws, by the name of the measure."""


@own_style()
def novelty_ratios(adversaries: Mapping[str, Mapping[str, Sequence[float]]], title: str) -> Figure:
    """Draw the novelty of each adversary divided by that of ideal samples; bars are means of runs.

    Args:
        adversaries: The ratios of each run by adversary, at least one, and by measure:
            `novelty_ratio`, `novelty_fifth_ratio`, `image_novelty_ratio`.
        title: The line above the chart.
    """
    values_of = {
        name: [ratios[key] for ratios in adversaries.values()]
        for key, name in NOVELTY_PANELS.items()
    }
    panels = [(name, values) for name, values in values_of.items() if any(values)]
    figure = new_figure(2.0 + 3.2 * len(panels), 0.27 * len(adversaries) + 1.3)
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axes, (name, values) in zip(grid, panels, strict=True):
        for row, (label, ratios) in enumerate(zip(adversaries, values, strict=True)):
            if not ratios:  # nothing drawn unclipped would spoil the layout
                continue
            colour, rows = family_of(label).colour, [row] * len(ratios)
            axes.plot(ratios, rows, "o", color=(colour, 0.35), markersize=5, clip_on=False)
            mean = float(np.mean(ratios))
            axes.plot(mean, row, "|", color=colour, markersize=11, mew=2.2, clip_on=False)
        axes.axvline(1.0, color=ACCENT, linewidth=1, linestyle=(0, (4, 3)))
        axes.set_xlim(0, max(1.1, 1.05 * max(ratio for ratios in values for ratio in ratios)))
        axes.set_xlabel(name)
        axes.set_yticks(range(len(adversaries)), list(adversaries))
        axes.set_ylim(len(adversaries) - 0.4, -0.6)
        tidy(axes, grid="y")
        _hide_left(axes)
    _title(figure, title)
    return figure


def _hide_left(axes: Axes) -> None:
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def _styles(colours: Sequence[str]) -> list[object]:
    dashes: list[object] = ["-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 1.5, 1.5, 1.5)), (0, (9, 3))]
    return [dashes[colours[:i].count(c) % len(dashes)] for i, c in enumerate(colours)]


def _short_names(curves: Sequence[Curve]) -> tuple[list[str], list[str]]:
    """Name curves; one that many adversaries share gets a mark, explained in a note."""
    names, notes = [], list[str]()
    for curve in curves:
        if not _is_shared(curve):
            names.append(", ".join(curve.labels))
            continue
        mark = "*" * (len(notes) + 1)
        names.append(f"shared Ω{mark}")
        notes.append(textwrap.fill(f"{mark} {', '.join(curve.labels)}", 120))
    return names, notes


def _is_shared(curve: Curve) -> bool:
    return len(curve.labels) > 2


def _families(figure: Figure, labels: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    shown = {family_of(label) for label in labels}
    handles = [
        Line2D([], [], color=f.colour, marker=f.marker, ls="", markersize=6, label=f.name)
        for f in FAMILIES
        if f in shown
    ]
    figure.legend(handles=handles, loc="outside lower right", ncols=5, frameon=False, fontsize=8.5)


def _title(figure: Figure, title: str, below: str = "") -> None:
    text = f"{title}\n{below}" if below else title
    figure.suptitle(text, x=0.01, ha="left", fontsize=11, color=INK)


def label_ends(
    axes: Axes, ends: Floats, names: Sequence[str], colours: Sequence[str]
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
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    pixel = figure.dpi / 72
    anchors, frame = axes.transData.transform(ends), axes.get_window_extent()
    heights = _spread(anchors[:, 1], 1.35 * _SIZE * pixel, frame.y0, frame.y1)
    texts = []
    for anchor, height, name, colour in zip(anchors, heights, names, colours, strict=True):
        place = np.array([frame.x1 + 16 * pixel, height])
        line = axes.transData.inverted().transform([anchor, place - [3 * pixel, 0]]).T
        axes.plot(
            *line, color=(colour, 0.55), linewidth=0.7, scalex=False, scaley=False, clip_on=False
        )
        x, y = axes.transData.inverted().transform(place)
        texts.append(axes.text(x, y, name, fontsize=_SIZE, color=colour, va="center"))
    return texts


def _spread(wanted: Floats, gap: float, low: float, high: float) -> Floats:
    """Move heights apart, as little as need be: at least a gap between any two, in order."""
    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(wanted))
    starts = isotonic_regression(wanted[order] - steps).x
    placed = np.clip(starts, low, max(low, high - gap * (len(wanted) - 1)))
    heights = np.empty(len(wanted))
    heights[order] = placed + steps
    return heights
