"""Parameters that are the knots of a curve over the episode: where failures and passes lie."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.analyses.plots.style import (
    FOOLED,
    UNHURT,
    axis_label,
    new_figure,
    places,
    span,
    tidy,
)
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK
from sada_gym.parameters import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KNOT = re.compile(r"(.+)\[(\d+)\]")
_BAND = (0.1, 0.5, 0.9)
_FEWEST, _COLUMNS = 2, 3


def curves_of(space: ParameterSpace) -> dict[str, list[int]]:
    """Return the parameters that are the knots of a curve, in their order, by the curve's name."""
    found: dict[str, list[int]] = {}
    for i, name in enumerate(space.names):
        match = _KNOT.fullmatch(name)
        if match and int(match[2]) == len(found.get(match[1], [])):
            found.setdefault(match[1], []).append(i)
    return {name: knots for name, knots in found.items() if len(knots) > 1}


@own_style()
def curves(space: ParameterSpace, worlds: Evaluations, threshold: float) -> Figure:
    """Draw of each curve the band that holds 80 % of failures, and that of passes."""
    found, fooled = curves_of(space), worlds.fooled(threshold)
    columns = min(_COLUMNS, len(found))
    rows = -(-len(found) // columns)
    figure = new_figure(4.2 * columns + 0.6, 2.6 * rows + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(found) :]:
        axes.set_visible(False)
    values = space.physical(worlds.mu)
    for axes, knots in zip(grid.flat, found.values(), strict=False):
        way = np.linspace(0.0, 100.0, len(knots))
        parameter = space.parameters[knots[0]]
        for these, colour, dashes, name in (
            (~fooled, UNHURT, (0, (4, 2)), "pass"),
            (fooled, FOOLED, "-", "fail"),
        ):
            if these.sum() < _FEWEST:
                continue
            levels = np.quantile(values[these][:, knots], _BAND, axis=0)
            low, middle, high = (places(parameter, level) for level in levels)
            axes.fill_between(way, low, high, color=colour, alpha=0.25, linewidth=0)
            label = f"{these.sum():,} worlds {name}"
            axes.plot(way, middle, color=colour, linestyle=dashes, linewidth=1.6, label=label)
        axes.set_xlabel("time in the episode (%)")
        axes.set_ylabel(axis_label(parameter).replace("[0]", ""))
        axes.set_xlim(0, 100)
        span(axes, "y", parameter)
        tidy(axes, grid="y")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, frameon=False)
    title = "Over the episode: medians, and bands of 80 %"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    return figure
