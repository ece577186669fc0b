"""Draw how often random worlds fool an agent, over the two parameters that matter most.

python -m tools.draw_weaknesses

The maps are from the reference sets; the chart of the racing pilot is from a table of its studies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sada_gym import make_application
from sada_gym.analyses.plots.style import axis_label, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.figures import number
from sada_gym.measures.reference import load_reference
from sada_gym.parameters import Parameter
from tools.draw_environments import COLOURS
from tools.draw_results import DOCS, IMAGES, ON_ORANGE, named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CELLS = 6
MAPS = {
    "detection": (
        ("camera_azimuth_deg", "camera_pitch_deg"),
        {"SADA-Detection-Car-v0": ""},
    ),
    "digits": (
        ("rotation_deg", "scale"),
        {"SADA-Digits-3-v0": "digit 3", "SADA-Digits-7-v0": "digit 7"},
    ),
    "robot": (("lidar_yaw_deg", "wheel_gain"), {"SADA-Robot-Warehouse-v0": ""}),
    "driving": (
        ("camera_pitch_deg", "camera_height_m"),
        {
            "SADA-Driving-Straight-v0": "Straight",
            "SADA-Driving-OneCurve-v0": "One Curve",
            "SADA-Driving-Navigation-v0": "Navigation",
        },
    ),
    "quadrotor": (
        ("torque_to_inertia", "delay_s"),
        {"SADA-Quadrotor-Crazyflie-v0": "Crazyflie", "SADA-Quadrotor-X500-v0": "X500"},
    ),
}
"""Of each environment's page: two parameters, and the tracks with their titles."""

LABELS = {
    "delay_s": ("age of observations (ms)", 1000.0),
    "lidar_yaw_deg": ("lidar yaw (°), + is left", 1.0),
    "wheel_gain": ("wheel gain (%), + pulls left", 100.0),
}
"""Axes whose labels are not the parameters' names, and by what their values are multiplied."""


def label_and_values(parameter: Parameter, shares: np.ndarray) -> tuple[str, np.ndarray]:
    """Return an axis's label and the values at shares of a range, as the pages write them."""
    label, factor = LABELS.get(parameter.name, (axis_label(parameter), 1.0))
    return label, factor * parameter.values(shares)


def draw_map(axes: Axes, track: str, across: str, up: str) -> None:
    """Draw the share of a reference set's evaluations that fool, in cells of two parameters."""
    application = make_application(track)
    reference = load_reference(track, application)
    names, space = application.parameters.names, list(application.parameters)
    x, y = names.index(across), names.index(up)
    edges = np.linspace(-1, 1, CELLS + 1)
    at = reference.mu[:, y], reference.mu[:, x]
    fooled, *_ = np.histogram2d(*at, [edges, edges], weights=reference.fooling_rate)
    counted, *_ = np.histogram2d(*at, [edges, edges])
    rates = 100 * fooled / counted
    axes.imshow(rates, cmap="Oranges", vmin=0, vmax=130, aspect="auto", origin="lower")
    for (i, j), rate in np.ndenumerate(rates):
        axes.text(j, i, f"{rate:.0f}", ha="center", va="center", fontsize=10, color=ON_ORANGE)
    for side, parameter in (("x", space[x]), ("y", space[y])):
        label, values = label_and_values(parameter, (edges[[0, CELLS // 2, CELLS]] + 1) / 2)
        axes.set(**{f"{side}label": label})
        axis = axes.xaxis if side == "x" else axes.yaxis
        ticks = np.array([0, CELLS // 2, CELLS]) - 0.5
        axis.set_ticks(ticks, labels=[number(float(f"{value:.3g}")) for value in values])
    tidy(axes)


def maps(page: str) -> Figure:
    """Draw the maps of one page beside each other."""
    (across, up), tracks = MAPS[page]
    figure = new_figure(2.6 * max(len(tracks), 1.6), 2.8)
    panels = figure.subplots(1, len(tracks), sharey=True, squeeze=False)[0]
    for axes, (track, title) in zip(panels, tracks.items(), strict=True):
        draw_map(axes, track, across, up)
        axes.set_title(title, fontsize=10, loc="left")
    for axes in panels[1:]:
        axes.set_ylabel("")
    return figure


def over_length() -> Figure:
    """Draw how often random tracks fool the racing pilot, by their length."""
    heading, *rows = named(DOCS / "environments" / "uav-studies.md", "tracks by length")
    rows = [row for row in rows if "%" in row[1]]
    figure = new_figure(5.6, 3.0)
    axes = figure.subplots()
    marks = zip(COLOURS[2:], "osD", strict=False)
    for (k, name), (colour, mark) in zip(enumerate(heading[1:], 1), marks, strict=False):
        rates = [float(row[k].partition(" %")[0]) for row in rows]
        axes.plot(range(len(rows)), rates, color=colour, marker=mark, label=name)
    axes.set_xticks(range(len(rows)), labels=[row[0].replace(" fifth", "") for row in rows])
    axes.set(ylim=(0, 50), xlabel="tracks by length, in fifths", ylabel="tracks that fool, %")
    axes.legend(frameon=False, fontsize=9)
    tidy(axes, grid="y")
    return figure


@own_style()
def main() -> None:
    """Draw them all."""
    for page in MAPS:
        (IMAGES / f"weakness-{page}.svg").write_bytes(svg(maps(page)))
    (IMAGES / "weakness-uav.svg").write_bytes(svg(over_length()))


if __name__ == "__main__":
    main()
