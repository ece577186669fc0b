"""How the chance of failing changes along each parameter, and over the two that matter most."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sada_gym.analyses.plots.style import (
    ACCENT,
    FOOLED,
    UNHURT,
    axis_label,
    near_whole,
    new_figure,
    places,
    span,
    tidy,
)
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK
from sada_gym.measures.sensitivity import FailureModel, Influence
from sada_gym.parameters import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_CURVES = 8
"""Parameters whose curves are drawn, those that matter most."""
_MOST_APART = 12
"""So many choices or whole numbers are drawn one by one."""


@own_style()
def influence(
    space: ParameterSpace, model: FailureModel, samples: Evaluations, threshold: float
) -> Figure:
    """Draw P(failure | value) for each parameter, with a band of 90 %, and a map of the first two.

    All other parameters are uniform. The samples lie on the map.
    """
    influences = model.influences(space.names)
    shown = influences[:MAX_CURVES]
    panels = len(shown) + (len(shown) > 1)
    columns = min(3, panels)
    rows = -(-panels // columns)
    figure = new_figure(3.1 * max(columns, 2), 2.5 * rows + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[panels:]:
        axes.set_visible(False)
    for axes, row in zip(grid.flat, shown, strict=False):
        _draw_curve(axes, space, model, row)
    for axes in grid.flat[: len(shown) : columns]:
        axes.set_ylabel("P(failure) (%)")
    if len(shown) > 1:
        _draw_map(grid.flat[panels - 1], space, model, shown)
        _draw_samples(grid.flat[panels - 1], space, samples, threshold, shown)
    title = "How the chance of failing changes with each parameter"
    if len(shown) < len(space):
        title += f": the {len(shown)} that matter most of {len(space)}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    return figure


def _draw_curve(axes: Axes, space: ParameterSpace, model: FailureModel, row: Influence) -> None:
    i = space.names.index(row.parameter)
    parameter = space.parameters[i]
    mu, bands = model.curve(i)
    mean, low, high = bands
    values, count = _physical(space, i, mu), parameter.count
    if 0 < count <= _MOST_APART:
        cells = np.minimum(((mu + 1.0) / 2.0 * count).astype(int), count - 1)
        parts = [cells == k for k in range(count)]
        mean, low, high = (np.array([row[part].mean() for part in parts]) for row in bands)
        values = _physical(space, i, (2.0 * np.arange(count) + 1.0) / count - 1.0)
        axes.vlines(values, 100 * low, 100 * high, color=ACCENT, alpha=0.4, linewidth=5)
        axes.plot(values, 100 * mean, color=ACCENT, linewidth=0, marker="o")
    else:
        axes.fill_between(values, 100 * low, 100 * high, color=ACCENT, alpha=0.2, linewidth=0)
        axes.plot(values, 100 * mean, color=ACCENT, linewidth=1.6)
    axes.set_ylim(0, 100)
    axes.set_xlabel(axis_label(parameter))
    axes.set_title(f"explains {100 * row.total:.0f} %", loc="left", fontsize=11, color=INK)
    tidy(axes, grid="y")
    span(axes, "x", parameter)


def _draw_map(
    axes: Axes, space: ParameterSpace, model: FailureModel, shown: tuple[Influence, ...]
) -> None:
    i, j = (space.names.index(row.parameter) for row in shown[:2])
    mu, mean = model.map(i, j)
    x, y = _physical(space, i, mu), _physical(space, j, mu)
    mesh = axes.pcolormesh(x, y, 100 * mean, cmap="cividis", vmin=0, vmax=100, shading="gouraud")
    mesh.set_rasterized(True)
    bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.9)
    bar.outline.set_visible(False)
    bar.set_label("P(failure) (%)")
    axes.set_xlabel(axis_label(space.parameters[i]))
    axes.set_ylabel(axis_label(space.parameters[j]))
    tidy(axes)
    span(axes, "x", space.parameters[i])
    span(axes, "y", space.parameters[j])


def _draw_samples(
    axes: Axes,
    space: ParameterSpace,
    samples: Evaluations,
    threshold: float,
    shown: tuple[Influence, ...],
) -> None:
    values, fooled = space.physical(samples.mu), samples.fooled(threshold)
    i, j = (space.names.index(row.parameter) for row in shown[:2])
    x, y = (
        places(space.parameters[k], near_whole(space.parameters[k], values[:, k])) for k in (i, j)
    )
    for rows, colour, marker, name in (
        (~fooled, UNHURT, "o", "sample that passes"),
        (fooled, FOOLED, "^", "that fails"),
    ):
        axes.scatter(
            x[rows],
            y[rows],
            s=32,
            color=colour,
            marker=marker,
            edgecolors="white",
            linewidths=0.6,
            clip_on=False,
            label=name,
        )
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderpad=0.0,
        ncols=2,
        frameon=False,
        fontsize=9,
        handletextpad=0.1,
        columnspacing=0.8,
    )


def _physical(space: ParameterSpace, i: int, mu: Floats) -> Floats:
    points = np.zeros((len(mu), len(space)), np.float32)
    points[:, i] = mu
    return places(space.parameters[i], space.physical(points)[:, i])
