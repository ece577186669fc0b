"""The style that all pictures share: figures, colours, axes and their labels."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Literal

import numpy as np

from sada_gym.frames import GRID, INK, MUTED, SKY, VERMILLION
from sada_gym.parameters import Parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOOLED, UNHURT, OMEGA, ACCENT = VERMILLION, SKY, "#a9b4c0", INK
HATCH = "////"
"""What fooled is hatched as well, so that it stands out without colour."""


def new_figure(width: float, height: float) -> Figure:
    """Make a figure without pyplot, which would keep it in a global list."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained", facecolor="white")


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def axis_label(parameter: Parameter) -> str:
    """Write a parameter as people read it: its name, and its unit in brackets."""
    unit = "°" if parameter.unit == "deg" else parameter.unit
    return _plain(f"{parameter.label} ({unit})" if unit else parameter.label)


def _plain(text: str) -> str:
    return text.replace("$", r"\$")  # matplotlib takes dollars for formulae


def name_choices(axes: Axes, parameter: Parameter) -> None:
    """Write a parameter's choices below the axis along which it is drawn, if it has any."""
    if parameter.choices:
        edges = np.linspace(parameter.low, parameter.high, len(parameter.choices) + 1)
        axes.set_xticks((edges[:-1] + edges[1:]) / 2, list(map(_plain, parameter.choices)))
        axes.tick_params(axis="x", length=0, labelsize=7)
        for label in axes.get_xticklabels():
            label.set(rotation=35, ha="right", rotation_mode="anchor")


def tidy(axes: Axes, *, grid: Literal["y", "both"] | None = None) -> None:
    """Style axes: two thin spines, grey ticks, and grid lines for `y` or `both` if asked."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(MUTED)
    axes.tick_params(colors=MUTED, labelsize=8)
    axes.xaxis.label.set_color(INK)
    axes.yaxis.label.set_color(INK)
    if grid is not None:
        axes.grid(axis=grid, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
