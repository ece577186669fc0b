"""Pictures of an attack: the adversary's choices, the agent's scores, and fooled frames."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application, Frame
from sada_gym.evaluation.oracle import Evaluations
from sada_gym.files import write_file
from sada_gym.parameters import ParameterSpace
from sada_gym.plots.style import (
    ACCENT,
    FOOLED,
    INK,
    MUTED,
    OMEGA,
    SAMPLES,
    axis_label,
    name_choices,
    new_figure,
    png,
    tidy,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_FRAMES = 24

_BINS = 20
_COLUMNS = 6


def draw_attack(
    application: Application,
    samples: Evaluations,
    queries: Evaluations,
    folder: Path,
    *,
    headline: str = "",  # noqa: ARG001
    on_progress: Callable[[int, int], None] = lambda *_: None,
) -> tuple[Path, ...]:
    """Draw all pictures of an attack into a folder.

    Args:
        application: The application that was attacked.
        samples: The adversary's test samples.
        queries: The training queries (Omega).
        folder: The folder for the PNG files.
        headline: A sentence on where the agent fails.
        on_progress: Called with the number of frames drawn, and of all.

    Returns:
        The files written. The contact sheet is left out where the application draws no frames or
        no sample fooled the agent; the map is drawn in two dimensions only.
    """
    space, threshold = application.parameters, application.fooling_threshold
    figures = {
        "marginals.png": marginals(space, samples, threshold),
        "scores.png": score_histogram(samples, queries, threshold),
    }
    if len(space) == 2:
        figures["map.png"] = scatter(space, samples, queries, threshold)
    fooled = np.flatnonzero(samples.score <= threshold)[:MAX_FRAMES]
    try:
        frames = []
        for done, i in enumerate(fooled):
            frames.append(application.render(samples.mu[i], int(samples.seed[i])))
            on_progress(done + 1, len(fooled))
    except NotImplementedError as error:
        frames = []
        warnings.warn(f"No frames are drawn. {error}", stacklevel=2)
    if frames:
        captions = [f"Q = {samples.score[i]:.2f}" for i in fooled]
        count = int((samples.score <= threshold).sum())
        shown = f"the first {len(frames)} of {count}" if count > len(frames) else f"all {count}"
        title = f"Samples that fool the agent (Q ≤ {threshold:g}): {shown}"
        figures["fooled.png"] = contact_sheet(frames, captions, title)
    for name, figure in figures.items():
        write_file(folder / name, png(figure))
    return tuple(folder / name for name in figures)


def marginals(space: ParameterSpace, samples: Evaluations, threshold: float) -> Figure:
    """Draw how the samples spread over each parameter's range, against uniform.

    Args:
        space: The d parameters.
        samples: The n test samples.
        threshold: The fooling threshold; samples that fool the agent stand out.
    """
    columns = min(4, len(space))
    rows = -(-len(space) // columns)
    figure = new_figure(3.1 * max(columns, 2), 2.3 * rows + 0.9)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    values, fooled = space.physical(samples.mu), samples.score <= threshold
    for i, axes in enumerate(grid.flat):
        if i >= len(space):
            axes.set_visible(False)
            continue
        parameter = space.parameters[i]
        bins = len(parameter.choices) or _BINS
        edges = np.linspace(parameter.low, parameter.high, bins + 1)
        axes.hist(
            [values[fooled, i], values[~fooled, i]],
            bins=list(edges),
            weights=[_percent(fooled.sum(), len(samples)), _percent((~fooled).sum(), len(samples))],
            stacked=True,
            color=[FOOLED, SAMPLES],
            label=["fool the agent", "do not fool it"],
        )
        axes.axhline(100 / bins, color=ACCENT, linewidth=1, linestyle=(0, (4, 3)), label="uniform")
        axes.set_xlim(parameter.low, parameter.high)
        axes.set_xlabel(axis_label(parameter))
        tidy(axes, grid="y")
        name_choices(axes, parameter)
    for axes in grid[:, 0]:
        axes.set_ylabel("samples (%)")
        axes.yaxis.get_major_locator().set_params(nbins=5, steps=[1, 2, 5, 10])
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle(f"Where {len(samples)} samples lie", x=0.01, ha="left", fontsize=12, color=INK)
    return figure


def score_histogram(samples: Evaluations, queries: Evaluations, threshold: float) -> Figure:
    """Draw the scores of the adversary's samples and of the training queries (Omega).

    Args:
        samples: The test samples.
        queries: The training queries; may be empty.
        threshold: The fooling threshold, drawn as a line.
    """
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    top = max(1.0, float(samples.score.max()), float(queries.score.max(initial=0.0)))
    low = min(0.0, float(samples.score.min()), float(queries.score.min(initial=0.0)))
    edges = list(np.linspace(low, top, 2 * _BINS + 1))
    for scores, colour, name in (
        (queries.score, OMEGA, f"{len(queries):,} training queries"),
        (samples.score, FOOLED, f"{len(samples):,} samples of the adversary"),
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


def scatter(
    space: ParameterSpace, samples: Evaluations, queries: Evaluations, threshold: float
) -> Figure:
    """Draw a two-dimensional problem's training queries and samples on a map.

    Args:
        space: Two parameters.
        samples: The test samples.
        queries: The training queries.
        threshold: The fooling threshold; queries that fooled the agent stand out.
    """
    figure = new_figure(5.4, 5.4)
    axes = figure.subplots()
    fooled = queries.score <= threshold
    for mu, colour, size, name in (
        (queries.mu[~fooled], "#d5dbe1", 7, "training query"),
        (queries.mu[fooled], SAMPLES, 9, "training query that fooled the agent"),
        (samples.mu, ACCENT, 11, "sample of the adversary"),
    ):
        x, y = space.physical(mu).T
        axes.scatter(x, y, s=size, color=colour, linewidths=0, label=name, clip_on=False)
    across, up = space.parameters
    axes.set_xlim(across.low, across.high)
    axes.set_ylim(up.low, up.high)
    axes.set_xlabel(axis_label(across))
    axes.set_ylabel(axis_label(up))
    axes.set_box_aspect(1)
    tidy(axes)
    figure.legend(loc="outside upper left", ncols=1, frameon=False, markerscale=1.8)
    return figure


def contact_sheet(frames: Sequence[Frame], captions: Sequence[str], title: str) -> Figure:
    """Lay frames out in rows, each with a caption.

    Args:
        frames: RGB images of one shape.
        captions: A short line for each frame.
        title: A line above all of them.
    """
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
