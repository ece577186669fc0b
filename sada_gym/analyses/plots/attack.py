"""Pictures of an attack: the adversary's choices, the agent's scores, and fooled frames."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sada_gym.analyses.plots.curves import curves
from sada_gym.analyses.plots.failure_sheet import png_of
from sada_gym.analyses.plots.failures import NotDrawnError, draw_failures
from sada_gym.analyses.plots.influence import influence
from sada_gym.analyses.plots.sphere import sphere, spheres_of
from sada_gym.analyses.plots.style import (
    ACCENT,
    FOOLED,
    HATCH,
    OMEGA,
    UNHURT,
    axis_label,
    bins_of,
    new_figure,
    places,
    png,
    span,
    svg,
    tidy,
)
from sada_gym.application import Application
from sada_gym.errors import Notice
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.files import write_file
from sada_gym.foundations.frames import BLUE, GRID, INK, MUTED, ORANGE, Frame
from sada_gym.measures.sensitivity import fit_failures
from sada_gym.parameters import ParameterSpace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_PARAMETERS = 16
"""Parameters in the picture of marginals."""

FOR_PAGES = ("sphere.png", "curves.png", "influence.png")
"""What a report shows, too: these are drawn as SVG as well."""
_BINS = 20
_COLUMNS = 6
_BAR = 0.8
"""The width of the bar of a choice or a whole number, as a share of its place."""


def draw_attack(
    application: Application,
    samples: Evaluations,
    queries: Evaluations,
    folder: Path,
    *,
    headline: str = "",
    on_progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
    on_frame: Callable[[int, Frame], None] = lambda sample, frame: None,  # noqa: ARG005
) -> tuple[Path, ...]:
    """Draw all pictures of an attack into a folder, and return the PNG files written.

    The sheet of failures, with the headline on top, is left out where the application draws no
    frames, where its drawing fails, or where no sample fooled the agent; the curves of P(failure)
    where there are too few worlds; the map of queries (Omega) and samples is drawn in two
    dimensions only, curves over the episode where parameters are their knots, and the sphere where
    parameters are directions around an object.
    `on_progress` is called after each frame with the numbers of frames drawn and of all frames, and
    `on_frame` with the sample's row and the frame.
    """
    space, threshold = application.parameters, application.fooling_threshold
    figures = {
        "marginals.png": marginals(space, samples, threshold),
        "scores.png": score_histogram(samples, queries, threshold),
    }
    worlds = Evaluations.joined([queries, samples]).valid
    model = fit_failures(worlds.mu, worlds.fooled(threshold))
    if model is not None:
        figures["influence.png"] = influence(space, model, samples, threshold)
    if len(space) == 2:
        figures["map.png"] = scatter(space, samples, queries, threshold)
    if found := getattr(application, "curves", {}):
        figures["curves.png"] = curves(space, found, worlds, threshold)
    if spheres_of(space):
        figures["sphere.png"] = sphere(space, samples, threshold)
    for name, figure in figures.items():
        write_file(folder / name, png(figure))
        if name in FOR_PAGES:
            write_file((folder / name).with_suffix(".svg"), svg(figure))
    names = [*figures]
    if samples.fooled(threshold).any():
        try:
            sheet = draw_failures(application, samples, headline, on_progress, on_frame)
        except NotDrawnError as error:
            warnings.warn(f"No frames are drawn{error}", Notice, stacklevel=2)
        else:
            write_file(folder / "fooled.png", png_of(sheet))
            names.append("fooled.png")
    return tuple(folder / name for name in names)


@own_style()
def marginals(space: ParameterSpace, samples: Evaluations, threshold: float) -> Figure:
    """Draw how the samples spread over each parameter's range, against uniform.

    Samples that fool the agent stand out. Of more than `MAX_PARAMETERS` parameters it draws those
    whose samples are farthest from uniform.
    """
    shown = _least_uniform(samples.mu)
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(3.1 * max(columns, 2), 2.3 * rows + 0.9)
    chosen = [bool(space.parameters[i].choices) for i in shown]
    mixed = any(chosen) and not all(chosen)  # few bars are much higher than many
    grid = figure.subplots(rows, columns, squeeze=False, sharey=not mixed)
    values, fooled = space.physical(samples.mu), samples.fooled(threshold)
    for i, axes in enumerate(grid.flat):
        if i >= len(shown):
            axes.set_visible(False)
            continue
        parameter = space.parameters[shown[i]]
        edges = bins_of(parameter)
        is_single = parameter.whole and np.ptp(edges) == len(edges) - 1
        at = places(parameter, values[:, shown[i]])
        axes.hist(
            [at[fooled], at[~fooled]],
            bins=list(places(parameter, edges)),
            weights=[_percent(fooled.sum(), len(samples)), _percent((~fooled).sum(), len(samples))],
            stacked=True,
            color=[FOOLED, UNHURT],
            hatch=[HATCH, ""],
            edgecolor="white",
            linewidth=0,
            rwidth=_BAR if parameter.choices or is_single else None,
            label=["fool the agent", "do not fool it"],
        )
        uniform = 100 * np.diff(parameter.shares(edges))
        line = {"color": ACCENT, "linewidth": 1, "linestyle": (0, (4, 3)), "label": "uniform"}
        if np.ptp(uniform) < 1e-9:
            axes.axhline(100 / len(uniform), **line)
        else:
            axes.stairs(uniform, places(parameter, edges), baseline=None, **line)
        axes.set_xlabel(axis_label(parameter))
        tidy(axes, grid="y")
        span(axes, "x", parameter)
    many = [axes for axes, few in zip(grid.flat, chosen, strict=False) if not few]
    for axes in many if mixed else ():
        axes.set_ylim(0.0, max(other.get_ylim()[1] for other in many))
    for axes in grid[:, 0]:
        axes.set_ylabel("samples (%)")
    for axes in grid.flat if mixed else grid[:, 0]:
        axes.yaxis.get_major_locator().set_params(nbins=5, steps=[1, 2, 5, 10])
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    title = f"Where {len(samples)} samples lie"
    if len(shown) < len(space):
        title += f", in the {len(shown)} least uniform of {len(space)} parameters"
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, color=INK)
    return figure


def _least_uniform(mu: npt.NDArray[np.float32]) -> list[int]:
    # Kolmogorov and Smirnov's distance from the uniform distribution
    ranks = (np.arange(len(mu))[:, None] + 0.5) / len(mu)
    distance = np.abs((np.sort(mu, axis=0) + 1.0) / 2.0 - ranks).max(axis=0)
    return sorted(np.argsort(-distance, kind="stable")[:MAX_PARAMETERS].tolist())


@own_style()
def score_histogram(samples: Evaluations, queries: Evaluations, threshold: float) -> Figure:
    """Draw the scores of the adversary's samples and of the training queries, if any."""
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    top = max(1.0, float(samples.score.max()), float(queries.score.max(initial=0.0)))
    low = min(0.0, float(samples.score.min()), float(queries.score.min(initial=0.0)))
    edges = list(np.linspace(low, top, 2 * _BINS + 1))
    for scores, colour, hatch, name in (
        (queries.score, OMEGA, "", f"{len(queries):,} training queries"),
        (samples.score, BLUE, HATCH, f"{len(samples):,} samples of the adversary"),
    ):
        if len(scores):
            weights = _percent(len(scores), len(scores))
            axes.hist(
                scores,
                edges,
                weights=weights,
                histtype="stepfilled",
                facecolor=(colour, 0.4),
                edgecolor=colour,
                hatch=hatch,
                linewidth=1.2,
                label=name,
            )
    axes.axvline(threshold, color=ACCENT, linewidth=1.2, linestyle=(0, (4, 3)))
    axes.annotate(
        f"fooled: Q ≤ {threshold:g}",
        (threshold, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(5, -4),
        textcoords="offset points",
        va="top",
        color=INK,
    )
    axes.set_xlim(low, top)
    axes.set_xlabel("score Q (low: the agent fails)")
    axes.set_ylabel("share (%)")
    tidy(axes, grid="y")
    figure.legend(loc="outside upper right", ncols=2, frameon=False)
    return figure


@own_style()
def scatter(
    space: ParameterSpace, samples: Evaluations, queries: Evaluations, threshold: float
) -> Figure:
    """Draw a two-dimensional problem's training queries and samples on a map."""
    figure = new_figure(5.4, 5.4)
    axes = figure.subplots()
    asked, drawn = queries.fooled(threshold), samples.fooled(threshold)
    for mu, colour, marker, size, name in (
        (queries.mu[~asked], "#c5ccd4", ".", 12, "training query"),
        (queries.mu[asked], ORANGE, "^", 12, "training query that fooled"),
        (samples.mu[~drawn], BLUE, "s", 12, "sample"),
        (samples.mu[drawn], ACCENT, "x", 18, "sample that fools"),
    ):
        values = zip(space.parameters, space.physical(mu).T, strict=True)
        x, y = (places(parameter, column) for parameter, column in values)
        axes.scatter(
            x, y, s=size, color=colour, marker=marker, linewidths=1, label=name, clip_on=False
        )
    across, up = space.parameters
    axes.set_xlabel(axis_label(across))
    axes.set_ylabel(axis_label(up))
    axes.set_box_aspect(1)
    tidy(axes)
    span(axes, "x", across)
    span(axes, "y", up)
    for parameter, draw_line in ((across, axes.axvline), (up, axes.axhline)):
        for edge in bins_of(parameter)[1:-1] if parameter.choices else ():
            draw_line(edge, color=GRID, linewidth=0.8, zorder=0)
    figure.legend(loc="outside upper left", ncols=2, frameon=False, markerscale=1.5)
    return figure


@own_style()
def contact_sheet(frames: Sequence[Frame], captions: Sequence[str], title: str) -> Figure:
    """Lay frames of one shape out in rows, each with a caption, under a title."""
    columns = max(3, min(_COLUMNS, len(frames)))  # room for the title
    rows = -(-len(frames) // columns)
    height, width = frames[0].shape[:2]
    cell = 1.75
    figure = new_figure(cell * columns + 0.1, (cell * height / width + 0.3) * rows + 0.35)
    grid = figure.subplots(rows, columns, squeeze=False)
    for i, axes in enumerate(grid.flat):
        axes.axis("off")
        if i < len(frames):
            axes.imshow(frames[i])
            axes.set_title(captions[i], fontsize=8.5, color=MUTED, pad=3)
    figure.suptitle(title, x=0.008, ha="left", fontsize=10, color=INK)
    return figure


def _percent(count: int, total: int) -> npt.NDArray[np.float64]:
    return np.full(int(count), 100.0 / total)
