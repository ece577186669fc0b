"""Draw docs/images/estimates.svg: estimated probabilities beside the true ones.

    python -m tools.draw_estimates

The first run of each of the twenty problems of `studies.rare` on which no setting was chosen, and
as many plain draws. It takes half a minute; with `--store FILE`, the runs that `studies.rare` kept
there are not made again.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.axes import Axes

from sada_gym.analyses.plots.style import new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, VERMILLION
from studies.rare import QUERIES, Outcome, in_rounds, now, numbers_of, plain, problems

OUT = Path(__file__).parents[1] / "docs" / "images" / "estimates.svg"
OURS, PLAIN = VERMILLION, "#94a1ae"
LEAST = 1e-7
"""Where the axis begins; 0 is drawn here."""


def bar(axes: Axes, run: Outcome, y: float, colour: str) -> None:
    """Draw an interval, and a dot for the estimate in it, open if it is refused."""
    low = max(run.low, LEAST)
    axes.plot((low, run.high), (y, y), color=colour, linewidth=3, solid_capstyle="butt")
    if run.probability > LEAST:
        face = "white" if run.refused else colour
        axes.scatter(run.probability, y, s=26, color=face, edgecolors=colour, zorder=3)


@own_style()
def main() -> None:
    """Make the runs and draw them, the rarest failures at the bottom."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--store", type=Path, help="a file that keeps the runs")
    store = parser.parse_args().store
    every = problems()
    numbers = sorted(numbers_of("judge"), key=lambda number: (every[number].truth, number))
    found = in_rounds({"now": now, "plain": plain}, numbers, 1, store)
    figure = new_figure(7.5, 5.2)
    axes = figure.subplots()
    for y, number in enumerate(numbers):
        (estimated,), (counted,) = found["now", number], found["plain", number]
        bar(axes, counted, y - 0.2, PLAIN)
        bar(axes, estimated, y + 0.2, OURS)
        truth = every[number].truth
        axes.plot((truth, truth), (y - 0.45, y + 0.45), color=INK, linewidth=1.6, zorder=4)
    axes.set_xscale("log")
    axes.set(xlim=(LEAST, 1.0), xlabel="probability of a failure", ylim=(-0.7, len(numbers) - 0.3))
    names = [f"{every[number].name}, d = {every[number].dimension}" for number in numbers]
    axes.set_yticks(range(len(numbers)), labels=names)
    for x, label, colour in (
        (0.0, "│ truth", INK),
        (0.18, f"● sada-gym estimate, {QUERIES:,} queries", OURS),
        (1.0, f"● {QUERIES:,} plain draws", PLAIN),
    ):
        side = "right" if x == 1.0 else "left"
        axes.text(x, 1.02, label, color=colour, transform=axes.transAxes, ha=side, fontsize=11)
    tidy(axes)
    OUT.write_bytes(svg(figure))


if __name__ == "__main__":
    main()
