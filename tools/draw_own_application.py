"""Draw docs/images/own-application.png, what an attack finds about the brake of the example.

    python -m tools.draw_own_application

The map shows the brake's Q over speed and friction, on a flat road with half the load. The dots are
samples of `level-set` after 1,000 queries.
"""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from sada_gym import adversaries
from sada_gym.analyses.plots.style import new_figure, png, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK
from sada_gym.oracle import Oracle

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "images" / "own-application.png"
EXAMPLE = ROOT / "examples" / "own_application.py"
GRID, BUDGET, SEED, DOTS, OUTLINE = 121, 1_000, 0, "#7a1f0b", "#c2410c"
COLOURS = LinearSegmentedColormap.from_list("q", ["#f0a988", "#f6ead9", "#d5e3ee", "#7fa8c9"])


@own_style()
def main() -> None:
    """Draw the map, train the adversary, and draw its samples."""
    application = runpy.run_path(str(EXAMPLE))["Braking"]()
    axis = np.linspace(-1, 1, GRID)
    speed, friction = (grid.ravel() for grid in np.meshgrid(axis, axis))
    mu = np.stack([speed, friction, 0 * speed, 0 * speed], axis=1)
    score = application.evaluate(mu, [0] * len(mu)).score.reshape(GRID, GRID)
    adversary = adversaries.make("level-set", 4, seed=SEED)
    with Oracle(application, budget=BUDGET, seed=SEED) as oracle:
        adversary.train(oracle)
    samples = adversary.sample(application.sample_size)
    seeds = list(range(len(samples)))
    fooled = application.evaluate(samples, seeds).fooled
    x, y = application.parameters.parameters[:2]
    extent = (x.low, x.high, y.low, y.high)
    figure = new_figure(7.5, 4)
    axes = figure.subplots()
    drawn = axes.imshow(
        score, origin="lower", extent=extent, aspect="auto", cmap=COLOURS, vmin=0, vmax=1
    )
    axes.contour(
        score, [application.fooling_threshold], extent=extent, colors=OUTLINE, linewidths=1.2
    )
    places = application.parameters.physical(samples)
    for mask, style in ((fooled, {"color": DOTS}), (~fooled, {"fc": "none", "ec": DOTS})):
        axes.scatter(*places[mask, :2].T, s=14, linewidths=0.8, **style)
    axes.set(xlabel="speed (m/s)", ylabel="friction")
    tidy(axes)
    figure.colorbar(drawn, ax=axes, label="Q: share of the energy that is braked away")
    said = f"{100 * fooled.mean():.0f} % of the samples fool the brake"
    axes.set_title(said, fontsize=11, color=INK, loc="left")
    print(said)
    OUT.write_bytes(png(figure))


if __name__ == "__main__":
    main()
