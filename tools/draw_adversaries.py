"""Draw the pictures of the pages about adversaries: what each samples where the truth is known.

    python -m tools.draw_adversaries            # all pictures
    python -m tools.draw_adversaries bbgan      # one of them

The plane is SADA-Analytic's: the agent is fooled inside four boxes, and Q grows with the distance
to them. Each adversary learns from 1,000 queries and draws 250 samples, with seed 0. Two pictures
show queries instead: where they are asked, from the first (pale) to the last (dark).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from sada_gym import adversaries
from sada_gym.analyses.plots.style import FOOLED, new_figure, png
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.oracle import Oracle

OUT = Path(__file__).parents[1] / "docs" / "images"
BUDGET, SAMPLES, SEED = 1_000, 250, 0
INSIDE, MISSED = "#fbe6d8", "#5b7fa6"
TIME = LinearSegmentedColormap.from_list("time", ["#d6e0ea", "#7f9fc0", "#1f3a5f"])

Mu = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Panel:
    """One small map: an adversary, its options, and whether its queries or its samples show."""

    name: str
    options: dict[str, Any] = field(default_factory=dict)
    queries: bool = False
    title: str = ""


PICTURES: dict[str, tuple[float, int, tuple[Panel, ...]]] = {
    "adversaries": (0.1, 4, tuple(map(Panel, ("random", "bayesian", "bbgan", "level-set")))),
    "baselines": (
        0.1,
        3,
        tuple(map(Panel, ("gaussian", "gmm10", "gmm50", "svm", "gp", "bayesian"))),
    ),
    "bbgan": (
        0.1,
        3,
        (
            Panel("bbgan", {"preset": "paper"}, title="bbgan, preset paper"),
            Panel("bbgan"),
            Panel("bbgan-boost"),
        ),
    ),
    "rare-events": (
        0.01,
        3,
        tuple(Panel(name, queries=True) for name in ("cross-entropy", "smc", "cma-mae")),
    ),
    "reinforcement-learning": (
        0.1,
        4,
        tuple(map(Panel, ("reinforce", "ppo", "sac", "td3"))),
    ),
    "level-set": (
        0.1,
        3,
        (Panel("level-set", queries=True), Panel("level-set"), Panel("trees")),
    ),
}
"""Each picture: the share of the plane that fools, its columns, its panels."""


def trained(
    panel: Panel, application: AnalyticApplication
) -> tuple[Mu, npt.NDArray[np.bool_], Mu, npt.NDArray[np.bool_]]:
    """Train, and give queries and samples, each with what fooled."""
    adversary = adversaries.make(panel.name, 2, seed=SEED, **panel.options)
    with Oracle(application, budget=BUDGET, seed=SEED) as oracle:
        adversary.train(oracle)
        asked = oracle.record
    mu = adversary.sample(SAMPLES)
    fooled = application.evaluate(mu, [0] * len(mu)).fooled
    return asked.mu, asked.fooled(application.fooling_threshold), mu, fooled


def draw_boxes(axes: Axes, application: AnalyticApplication) -> None:
    """Show the plane with the boxes inside which the agent is fooled."""
    width, height = 2 * application.half_sides
    for corner in application.centres - application.half_sides:
        axes.add_patch(Rectangle(corner, width, height, facecolor=INSIDE))
        edge = Rectangle(corner, width, height, fill=False, edgecolor=FOOLED, linewidth=0.9)
        edge.set_zorder(3)  # above the points, which may hide a small box
        axes.add_patch(edge)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), xticks=[], yticks=[], aspect="equal")
    for spine in axes.spines.values():
        spine.set(color=MUTED, linewidth=0.6)


def draw_samples(axes: Axes, mu: Mu, fooled: npt.NDArray[np.bool_]) -> None:
    """Show samples: filled where they fool, crosses where they miss."""
    axes.scatter(*mu[~fooled].T, s=11, marker="x", linewidths=0.8, color=MISSED)
    axes.scatter(*mu[fooled].T, s=9, color=FOOLED, linewidths=0)


def draw_queries(axes: Axes, mu: Mu) -> None:
    """Show queries, the later the darker."""
    axes.scatter(*mu.T, s=4, c=np.arange(len(mu)), cmap=TIME, linewidths=0)


def draw_panel(axes: Axes, panel: Panel, application: AnalyticApplication) -> None:
    """Draw one map and its two lines of title, and print its figures."""
    asked, found, mu, fooled = trained(panel, application)
    draw_boxes(axes, application)
    if panel.queries:
        draw_queries(axes, asked)
        said = f"{found.sum()} of {len(asked):,} queries fool"
    else:
        draw_samples(axes, mu, fooled)
        said = f"{fooled.mean():.0%} fool, {coverage(mu, fooled, application):.0%} covered"
    said = said.replace("%", " %")
    title = panel.title or panel.name
    shown = ": queries" if panel.queries else ""
    axes.set_title(f"{title}{shown}", fontsize=11, color=INK, pad=20)
    axes.text(0, 1.05, said, fontsize=9, color=MUTED, ha="center")
    print(f"{title}: {said}", flush=True)


def coverage(mu: Mu, fooled: npt.NDArray[np.bool_], application: AnalyticApplication) -> float:
    """Coverage of the boxes, as a share of what ideal samples reach."""
    rng = np.random.default_rng(SEED)
    points, ideal = (application.sample_fooling_set(n, rng) for n in (5_000, SAMPLES))
    reached: Callable[..., float] = lambda *of: fooling_coverage(*of, points).coverage  # noqa: E731
    return reached(mu, fooled) / reached(ideal, np.ones(SAMPLES, bool))


def draw_legend(figure: Figure, panels: tuple[Panel, ...]) -> None:
    """Explain what the panels show."""
    entries = []
    if not all(panel.queries for panel in panels):
        entries += [("a sample that fools", "o", FOOLED), ("a sample that misses", "x", MISSED)]
    if any(panel.queries for panel in panels):
        entries += [("an early query", "o", TIME(0.15)), ("a late query", "o", TIME(1.0))]
    box = Rectangle((0, 0), 1, 1, facecolor=INSIDE, edgecolor=FOOLED, label="fools the agent")
    dots = [
        Line2D([], [], marker=marker, color=colour, linestyle="", markersize=4, label=said)
        for said, marker, colour in entries
    ]
    figure.legend(
        handles=[box, *dots],
        loc="outside lower center",
        ncols=1 + len(dots),
        frameon=False,
        fontsize=9,
        labelcolor=INK,
    )


@own_style()
def draw(name: str) -> None:
    """Draw one picture into docs/images."""
    volume, columns, panels = PICTURES[name]
    application = AnalyticApplication(dimension=2, volume=volume)
    rows = -(-len(panels) // columns)
    height = rows * (9 / columns + 0.45) + 0.45
    figure = new_figure(9, height)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=True):
        draw_panel(axes, panel, application)
    draw_legend(figure, panels)
    # the layout leaves too little room for the highest titles
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - 0.15 / height))
    file = "adversaries" if name == "adversaries" else f"adversaries-{name}"
    (OUT / f"{file}.png").write_bytes(png(figure))


def main() -> None:
    """Draw the pictures that are named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pictures", nargs="*", help=", ".join(PICTURES))
    for name in parser.parse_args().pictures or PICTURES:
        draw(name)


if __name__ == "__main__":
    main()
