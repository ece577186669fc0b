"""Draw docs/images/landscape.png, one digit's landscape with adversaries' samples on it.

    python -m tools.draw_landscape random gmm10 gp bbgan smc cma-mae sac trees level-set

Two parameters warp one test image, so that Q is a function of the plane. The large map shows Q and
the outline of the fooling set; the small ones show the 250 samples of each adversary that is named,
after 1,000 queries.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from sada_gym import adversaries
from sada_gym.analyses.plots.style import axis_label, new_figure, png, tidy
from sada_gym.envs.digits import DigitsApplication
from sada_gym.evaluations import fools
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from sada_gym.oracle import Oracle
from sada_gym.parameters import ParameterSpace

OUT = Path(__file__).parents[1] / "docs" / "images" / "landscape.png"
ADVERSARIES = ("random", "gmm10", "gp", "bbgan", "smc", "cma-mae", "sac", "trees", "level-set")
PARAMETERS = ("rotation_deg", "scale")
IMAGE, BUDGET, SEED, GRID, COLUMNS = 9, 1_000, 0, 161, 3
COLOURS = LinearSegmentedColormap.from_list("q", ["#f0a988", "#f6ead9", "#d5e3ee", "#7fa8c9"])
DOTS, OUTLINE = "#7a1f0b", "#c2410c"
WORLDS = ((0.0, 0.0), (-0.85, -0.7), (0.9, -0.85))
"""The worlds that are drawn beside the large map."""


def landscape(application: DigitsApplication) -> np.ndarray:
    """Q on a grid, (scale, rotation)."""
    axis = np.linspace(-1, 1, GRID)
    mu = np.stack([grid.ravel() for grid in np.meshgrid(axis, axis)], axis=1)
    return application.evaluate(mu, [0] * len(mu)).score.reshape(GRID, GRID)


def draw_map(axes: Axes, application: DigitsApplication, score: np.ndarray) -> None:
    """Q as a map, with the fooling set's outline."""
    x, y = application.parameters.parameters
    extent = (x.low, x.high, y.low, y.high)
    axes.imshow(score, origin="lower", extent=extent, aspect="auto", cmap=COLOURS, vmin=0, vmax=1)
    level = [application.fooling_threshold]
    axes.contour(score, level, extent=extent, colors=OUTLINE, linewidths=1.2)
    axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
    tidy(axes)


def samples(name: str, application: DigitsApplication) -> np.ndarray:
    """What a trained adversary draws, (M, 2)."""
    adversary = adversaries.make(name, 2, seed=SEED)
    with Oracle(application, budget=BUDGET, seed=SEED) as oracle:
        adversary.train(oracle)
    return adversary.sample(application.sample_size)


def draw_worlds(axes: list[Axes], application: DigitsApplication) -> None:
    """The image at some places of the map, lettered as there."""
    for letter, one, mu in zip("ABC", axes, WORLDS, strict=True):
        mu32 = np.array(mu, np.float32)
        (info,) = application.evaluate(mu32[None], [0]).infos
        one.imshow(application.attacked_image(mu32, 0)[1], cmap="gray", vmin=0, vmax=1)
        said = f"{letter}: seen as {info['predicted']}, Q = {info['score']:.2f}"
        one.set_title(said, fontsize=9, color=OUTLINE if info["fooled"] else INK)
        one.axis("off")


def mark_worlds(axes: Axes, space: ParameterSpace) -> None:
    """Letters on the map where the drawn worlds are."""
    for letter, (x, y) in zip("ABC", space.physical(np.array(WORLDS)), strict=True):
        style = {"facecolor": "white", "edgecolor": INK, "boxstyle": "circle,pad=0.2"}
        axes.text(x, y, letter, ha="center", va="center", fontsize=9, color=INK, bbox=style)


@own_style()
def main() -> None:
    """Draw the landscape and train the adversaries that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("adversaries", nargs="*", default=list(ADVERSARIES))
    parser.add_argument("--image", type=int, default=IMAGE)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    application = DigitsApplication(image=arguments.image, parameters=PARAMETERS)
    score = landscape(application)
    label = int(application.images.labels[arguments.image])
    share = fools(score, application.fooling_threshold).mean()
    rows = -(-len(arguments.adversaries) // COLUMNS)
    figure = new_figure(9, 4.6 + 2.5 * rows)
    top, bottom = figure.subfigures(2, 1, height_ratios=[4.6, 2.5 * rows])
    grid = top.add_gridspec(3, 2, width_ratios=[3.2, 1])
    large = top.add_subplot(grid[:, 0])
    draw_map(large, application, score)
    mark_worlds(large, application.parameters)
    x, y = application.parameters.parameters
    large.set(xlabel=axis_label(x), ylabel=axis_label(y))
    said = f"Q from 1 (blue) to 0 (red); the outlined {100 * share:.0f} % fool"
    title = f"One handwritten {label}: {said}"
    large.set_title(title, fontsize=10, color=INK, loc="left")
    draw_worlds([top.add_subplot(grid[i, 1]) for i in range(3)], application)
    small = bottom.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, name in zip(small, arguments.adversaries, strict=False):
        mu = samples(name, application)
        fooled = application.evaluate(mu, [0] * len(mu)).fooled.mean()
        draw_map(axes, application, score)
        axes.scatter(*application.parameters.physical(mu).T, s=5, color=DOTS, linewidths=0)
        axes.set_title(f"{name}: {100 * fooled:.1f} % fool", fontsize=10, color=INK)
        print(f"{name}: {100 * fooled:.1f} % of {len(mu)} samples fool", flush=True)
    for axes in small[len(arguments.adversaries) :]:
        axes.axis("off")
    caption = f"{application.sample_size} samples of each adversary after {BUDGET:,} queries"
    bottom.suptitle(caption, fontsize=10, color=MUTED)
    arguments.out.write_bytes(png(figure))


if __name__ == "__main__":
    main()
