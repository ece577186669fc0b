"""The style that all pictures share: figures, colours, axes and their labels."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Literal

import numpy as np

from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.figures import number
from sada_gym.foundations.frames import GRID, INK, MUTED, SKY, VERMILLION
from sada_gym.parameters import Parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOOLED, UNHURT, OMEGA, ACCENT = VERMILLION, SKY, "#a9b4c0", INK
_THEME = {
    INK: ("ink", "#e6e8ea"),
    MUTED: ("soft", "#a3adb7"),
    GRID: ("line", "#353c44"),
    "#ffffff": ("card", "#1b1f24"),
    VERMILLION: ("fails", "#ff9351"),
    SKY: ("passes", "#6cc0f5"),
}
"""What a light page's colours are called, and what they become on a dark one."""
_BINS = 20
_SHORT_NAMES = 16
"""Letters of all names of choices that fit below an axis without being turned."""
HATCH = "////"
"""What fooled is hatched as well, so that it stands out without colour."""


def new_figure(width: float, height: float) -> Figure:
    """Make a figure without pyplot, which would keep it in a global list."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained", facecolor="white")


@own_style()
def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


@own_style()
def svg(figure: Figure) -> bytes:
    """Return a figure as the bytes of an SVG file that is light or dark as its reader's page is."""
    import matplotlib as mpl

    buffer = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "sada-gym"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, dpi=150)
    text = buffer.getvalue().decode()
    for colour, (name, _) in _THEME.items():
        text = text.replace(colour, f"var(--{name})")
    light = "".join(f"--{name}:{colour};" for colour, (name, _) in _THEME.items())
    dark = "".join(f"--{name}:{colour};" for name, colour in _THEME.values())
    style = f"<style>:root{{{light}}}text{{fill:var(--ink)}}@media(prefers-color-scheme:dark)"
    return text.replace("<defs>", f"{style}{{:root{{{dark}}}}}</style><defs>", 1).encode()


def axis_label(parameter: Parameter) -> str:
    """Write a parameter as people read it: its name, and its unit in brackets."""
    unit = "°" if parameter.unit == "deg" else parameter.unit
    return _plain(f"{parameter.label} ({unit})" if unit else parameter.label)


def _plain(text: str) -> str:
    return text.replace("$", r"\$")  # matplotlib takes dollars for formulae


def places(parameter: Parameter, values: Floats) -> Floats:
    """Return where physical values of a parameter stand on an axis that `span` made."""
    return parameter.shares(values) if parameter.log else values


def near_whole(parameter: Parameter, values: Floats) -> Floats:
    """Move physical values of whole numbers close to these, so that marks do not hide others."""
    return np.floor(values + 0.5) * 0.7 + values * 0.3 if parameter.whole else values


def span(axes: Axes, side: Literal["x", "y"], parameter: Parameter) -> None:
    """Let an axis span a parameter's range as evenly as mu does, with names of choices."""
    from matplotlib.ticker import MaxNLocator

    axis = axes.xaxis if side == "x" else axes.yaxis
    low, high = places(parameter, np.array([parameter.low, parameter.high])).tolist()
    axes.set(**{f"{side}lim": (low, high)})
    if parameter.choices:
        edges = np.linspace(low, high, len(parameter.choices) + 1)
        axis.set_ticks((edges[:-1] + edges[1:]) / 2, labels=list(map(_plain, parameter.choices)))
        axes.tick_params(axis=side, length=0, labelsize=7)
        crowded = sum(map(len, parameter.choices)) > _SHORT_NAMES
        for label in axes.get_xticklabels() if side == "x" and crowded else ():
            label.set(rotation=35, ha="right", rotation_mode="anchor")
    elif parameter.log:
        ticks = parameter.round_values(5)
        axis.set_ticks(parameter.shares(ticks), labels=list(map(number, ticks.tolist())))
    else:
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10], integer=parameter.whole))


def bins_of(parameter: Parameter) -> Floats:
    """Return the edges of a histogram, (k + 1,) physical values: a bar a choice or whole number."""
    low, high = parameter.low, parameter.high
    if parameter.choices:
        return np.linspace(low, high, len(parameter.choices) + 1)
    if parameter.whole and high - low <= 2 * _BINS:
        return np.arange(low, high + 0.5, dtype=np.float64)
    return parameter.values(np.linspace(0.0, 1.0, _BINS + 1))


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
