"""A picture of a density that was fitted to logged worlds: what was logged, what is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np

from sada_gym.analyses.plots.style import UNHURT, axis_label, new_figure, places, png, span
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK
from sada_gym.parameters import ParameterSpace

_COLUMNS, _BINS = 4, 30


@own_style()
def marginals(space: ParameterSpace, logged: Floats, drawn: Floats) -> bytes:
    """Draw the histograms of each parameter, logged, (n, d), and drawn, (m, d), as a PNG."""
    count = len(space)
    rows, columns = -(-count // _COLUMNS), min(count, _COLUMNS)
    figure = new_figure(2.6 * columns, 2.0 * rows + 0.4)
    grid = figure.subplots(rows, columns, squeeze=False).flat
    for axes, parameter, old, new in zip(grid, space.parameters, logged.T, drawn.T, strict=False):
        low, high = places(parameter, np.array([parameter.low, parameter.high])).tolist()
        edges = np.linspace(low, high, (parameter.count or _BINS) + 1)
        common: dict[str, Any] = {"bins": edges, "density": True}
        axes.hist(places(parameter, old), **common, color=UNHURT, alpha=0.6, label="logged")
        axes.hist(places(parameter, new), **common, histtype="step", color=INK, label="density")
        span(axes, "x", parameter)
        axes.set_xlabel(axis_label(parameter))
        axes.set_yticks([])
    for axes in list(figure.axes)[count:]:
        axes.remove()
    figure.axes[0].legend(fontsize=7)
    return png(figure)
