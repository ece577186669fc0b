"""Draw the charts of the environments' pages, each from a table that a page or study has.

python -m tools.draw_environments
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from tools.draw_results import DOCS, IMAGES, ROOT, bars, named

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (MUTED, "#009e73", UNHURT, FOOLED, "#cc79a7", INK)
WAYS = ("-", "--", "-", "-", "--", ":")


def over_pitch() -> Figure:
    """Draw how often uniform worlds fool the COCO detector, by the camera's pitch."""
    (_, *classes), *rows = named(ROOT / "studies" / "coco_tables.md", "pitch")
    figure = new_figure(6.5, 3.8)
    axes = figure.subplots()
    lasts = []
    for column, name in enumerate(classes, 1):
        cells = [[float(x) for x in re.findall(r"[\d.]+", row[column])] for row in rows]
        rates, lows, highs = zip(*cells, strict=True)
        colour, places = COLOURS[column - 1], range(len(rows))
        axes.plot(places, rates, color=colour, linestyle=WAYS[column - 1], marker="o", markersize=4)
        axes.fill_between(places, lows, highs, color=colour, alpha=0.12, linewidth=0)
        lasts.append([rates[-1], name, colour])
    height = -100.0
    for rate, name, colour in sorted(lasts):
        height = max(rate, height + 6)  # names do not overlap
        axes.text(len(rows) - 0.93, height, name, color=colour, va="center", fontsize=11)
    axes.set_xticks(range(len(rows)), labels=[row[0] for row in rows])
    axes.set(ylim=(0, 104), xlabel="the camera's pitch", ylabel="uniform worlds that fool, %")
    tidy(axes, grid="y")
    return figure


def over_seeds() -> Figure:
    """Draw which points of a reference set are in by luck or missing, by the number of seeds."""
    figure = new_figure(8, 3.4)
    panels = figure.subplots(1, 2)
    titles = ("in by luck, %", "missed, %")
    for axes, title in zip(panels, titles, strict=True):
        (_, *seeds), *rows = named(ROOT / "studies" / "reference_set_tables.md", title)
        for (name, *cells), colour, mark in zip(rows, COLOURS, "osD^", strict=False):
            axes.plot(
                list(map(int, seeds)), list(map(int, cells)), color=colour, marker=mark, label=name
            )
        axes.set_title(title, fontsize=11, color=INK, loc="left")
        axes.set(ylim=(0, 85), xlabel="seeds of each point", xticks=list(map(int, seeds)))
        tidy(axes, grid="y")
    panels[1].legend(frameon=False, fontsize=9)
    return figure


def of_pixel_attacks() -> Figure:
    """Draw how many of the first ten images each attack fools, at two radii of the noise."""
    radii = ("radius 0.15", "radius 0.25")
    heading, *rows = named(DOCS / "environments" / "pixel.md", radii[0])
    figure = new_figure(7.2, 3.2)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, radius in zip(panels, radii, strict=True):
        cells = [re.findall(r"\((\d+)\)", row[heading.index(radius)]) for row in rows]
        colours = [MUTED if row[1] == "gradient" else FOOLED for row in rows]
        colours = [
            UNHURT if row[0] == "Square" else c for row, c in zip(rows, colours, strict=True)
        ]
        values = [float(count) for (count,) in cells]
        bars(axes, [row[0] for row in rows], values, ".0f", color=colours)
        axes.set_title(radius, fontsize=11, color=INK, loc="left")
        axes.set(xlabel="images fooled, of ten", xlim=(0, 11))
        tidy(axes, grid="x")
    return figure


CHARTS = {
    "coco-pitch": over_pitch,
    "pixel-attacks": of_pixel_attacks,
    "reference-seeds": over_seeds,
}


@own_style()
def main() -> None:
    """Draw each chart."""
    for name, draw in CHARTS.items():
        (IMAGES / f"{name}.svg").write_bytes(svg(draw()))


if __name__ == "__main__":
    main()
