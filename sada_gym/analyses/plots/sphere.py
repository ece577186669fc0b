"""Draws samples on the sphere around an object: where its camera and its light stand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import GRID, INK, MUTED
from sada_gym.parameters import Parameter, ParameterSpace

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

_AZIMUTH, _PITCH = "azimuth_deg", "pitch_deg"
_STEP_DEG = 30


def spheres_of(space: ParameterSpace) -> list[tuple[int, int]]:
    """Return the places of azimuths, each with that of the pitch of the same thing.

    They are parameters such as `camera_azimuth_deg`, an angle that goes all around, and
    `camera_pitch_deg`.
    """
    names = space.names
    return [
        (i, names.index(partner))
        for i, parameter in enumerate(space.parameters)
        if parameter.directions and parameter.name.endswith(_AZIMUTH)
        if (partner := parameter.name.removesuffix(_AZIMUTH) + _PITCH) in names
    ]


@own_style()
def sphere(space: ParameterSpace, samples: Evaluations, threshold: float) -> Figure:
    """Draw the samples on each of `spheres_of`, seen from above; equal areas stay equal."""
    spheres = spheres_of(space)
    figure = new_figure(4.6 * len(spheres), 5.0)
    panels = figure.subplots(1, len(spheres), squeeze=False, subplot_kw={"projection": "polar"})
    values, fooled = space.physical(samples.mu), samples.fooled(threshold)
    for axes, (azimuth, pitch) in zip(panels.flat, spheres, strict=True):
        _scatter(axes, values[:, azimuth], values[:, pitch], fooled)
        _describe(axes, space.parameters[azimuth], space.parameters[pitch])
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, frameon=False)
    title = f"Where {len(samples)} samples lie around the object, seen from above"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    return figure


def _scatter(axes: PolarAxes, azimuth: Floats, pitch: Floats, fooled: Bools) -> None:
    angle, radius = np.radians(azimuth), _radius(pitch)
    for rows, colour, marker, size, name in (
        (~fooled, UNHURT, "o", 12, "passes"),
        (fooled, FOOLED, "^", 18, "fails"),
    ):
        axes.scatter(
            angle[rows],
            radius[rows],
            s=size,
            color=colour,
            marker=marker,
            linewidths=0,
            alpha=0.8,
            label=name,
            clip_on=False,
        )


def _radius(pitch_deg: Floats) -> Floats:
    # Lambert's projection: the zenith is in the middle, and the horizon at the square root of 2
    return np.asarray(2.0 * np.sin(np.radians(90.0 - pitch_deg) / 2.0))


def _describe(axes: PolarAxes, azimuth: Parameter, pitch: Parameter) -> None:
    axes.set_theta_zero_location("N")
    lowest = min(pitch.low, 0.0)
    axes.set_rlim(0.0, float(_radius(np.array(lowest))))
    rings = np.arange(_STEP_DEG * np.ceil(lowest / _STEP_DEG), 90.0, _STEP_DEG)
    axes.set_rgrids(_radius(rings).tolist(), [f"{ring:.0f}°" for ring in rings], angle=22.5)
    ahead, left, behind, right = azimuth.directions
    sides = [text.replace(" ", "\n", 1) for text in (left, right)]
    axes.set_thetagrids([0, 90, 180, 270], [ahead, sides[0], behind, sides[1]])
    axes.set_xlabel(f"{azimuth.label} all around; rings: {pitch.label}", color=INK)
    axes.tick_params(colors=MUTED, labelsize=8)
    axes.grid(color=GRID, linewidth=0.8)
    axes.spines["polar"].set_color(MUTED)
    axes.tick_params(axis="x", pad=22)
    axes.set_axisbelow(True)
