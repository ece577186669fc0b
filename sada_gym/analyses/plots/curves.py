"""Parameters that are the knots of a curve over the episode: where failures and passes lie."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

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
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sada_gym.foundations.arrays import Floats

_BAND = (0.1, 0.5, 0.9)
_FEWEST, _COLUMNS = 2, 3


@own_style()
def curves(
    space: ParameterSpace, found: Mapping[str, Any], worlds: Evaluations, threshold: float
) -> Figure:
    """Draw of each curve the band that holds 80 % of failures, and that of passes.

    `found` are the bindings with knots by their names; those of a parameter are NAME[0] and so on.
    """
    fooled = worlds.fooled(threshold)
    columns = min(_COLUMNS, len(found))
    rows = -(-len(found) // columns)
    figure = new_figure(4.2 * columns + 0.6, 2.6 * rows + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(found) :]:
        axes.set_visible(False)
    values = space.physical(worlds.mu)
    for axes, (name, binding) in zip(grid.flat, found.items(), strict=False):
        knots = [space.names.index(f"{name}[{i}]") for i in range(binding.knots)]
        parameter = space.parameters[knots[0]]
        for these, colour, dashes, what in (
            (~fooled, UNHURT, (0, (4, 2)), "pass"),
            (fooled, FOOLED, "-", "fail"),
        ):
            if these.sum() < _FEWEST:
                continue
            levels = np.quantile(values[these][:, knots], _BAND, axis=0)
            band = [places(parameter, level) for level in levels]
            style = {
                "color": colour,
                "linestyle": dashes,
                "label": f"{these.sum():,} worlds {what}",
            }
            _draw(axes, binding.curve == "steps", band, style)
        axes.set_xlabel(f"share of {binding.over:,} steps (%)")
        axes.set_ylabel(axis_label(parameter).replace("[0]", ""))
        axes.set_xlim(0, 100)
        span(axes, "y", parameter)
        tidy(axes, grid="y")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, frameon=False)
    title = "Over the episode: medians, and bands of 80 %"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    return figure


def _draw(axes: Axes, in_steps: bool, band: list[Floats], style: dict[str, Any]) -> None:
    """Draw a median between two others, from knot to knot, or constant for a part each."""
    if in_steps:  # the last part ends where the way does
        band = [np.append(values, values[-1]) for values in band]
    way, (low, middle, high) = np.linspace(0.0, 100.0, len(band[0])), band
    filled: dict[str, Any] = {"color": style["color"], "step": "post" if in_steps else None}
    axes.fill_between(way, low, high, alpha=0.25, linewidth=0, **filled)
    drawstyle = "steps-post" if in_steps else "default"
    axes.plot(way, middle, drawstyle=drawstyle, linewidth=1.6, **style)
