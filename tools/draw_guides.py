"""Draw the charts of the guides and their appendices in docs/images, from their tables.

python -m tools.draw_guides
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED
from tools.draw_results import named, tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCS = Path(__file__).parents[1] / "docs"
QUERIES, REACHED = (512, 2_048, 8_192), {1: (15, 63, 78), 8: (12, 48, 95)}
"""What `python examples/sb3_adversary.py` prints: the fooling set reached in %, by horizon."""


def numbers(cell: str) -> list[float]:
    """Return the numbers of a cell: a value, and the ends of its interval."""
    return [float(one) for one in re.findall(r"\d+(?:\.\d+)?", cell)]


def of_repair() -> Figure:
    """Draw how often three agents fail, by what they were trained on further."""
    found = [table for table in tables(DOCS / "appendix-repair.md") if "nominal Q" in table[0]]
    figure = new_figure(7.2, 2.9)
    panels = figure.subplots(1, 3, sharey=True)
    names = ("a lander", "the lidar robot", "the driver")
    for axes, (heading, *rows), name in zip(panels, found, names, strict=True):
        for label, colour, shift in (
            ("a new level-set's worlds", FOOLED, -0.18),
            ("uniform worlds", UNHURT, 0.18),
        ):
            column = heading.index(f"{label} that fool, %")
            cells = np.array([numbers(row[column]) for row in rows])
            places = np.arange(len(rows)) + shift
            errors = [cells[:, 0] - cells[:, 1], cells[:, 2] - cells[:, 0]]
            look = {"ecolor": MUTED, "color": colour, "height": 0.34, "label": label}
            axes.barh(places, cells[:, 0], xerr=errors, capsize=2, **look)
        axes.set_title(name, fontsize=10, color=INK, loc="left")
        axes.set(xlabel="fails in, %", xlim=(0, 105))
        tidy(axes)
    panels[0].set_yticks(range(len(found[0]) - 1), labels=[row[0] for row in found[0][1:]])
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False, fontsize=9)
    return figure


def of_diagnosis() -> Figure:
    """Draw how many planted weaknesses one rule finds, by their kind and by the method."""
    page = DOCS / "appendix-diagnosis.md"
    kinds = named(page, "kind of weakness")[1:]
    methods = named(page, "method")[1:]
    rows = [(row[0], numbers(row[1])) for row in methods]
    rows += [(f"{row[0]} ({row[1]})", numbers(row[2])) for row in kinds]
    figure = new_figure(7.2, 0.7 + 0.24 * len(rows))
    axes = figure.subplots()
    for i, (name, (value, low, high)) in enumerate(rows):
        place = i + 0.5 * (i >= len(methods))
        colour = MUTED if name in ("PRIM", "decision tree") else FOOLED
        axes.plot((low, high), (place, place), color=colour, lw=2, alpha=0.5)
        axes.plot(value, place, "o", ms=6, color=colour)
    places = [i + 0.5 * (i >= len(methods)) for i in range(len(rows))]
    axes.set_yticks(places, labels=[name for name, _ in rows])
    axes.set(xlabel="planted weaknesses that one rule finds, %", xlim=(0, 102))
    axes.invert_yaxis()
    tidy(axes, grid="x")
    return figure


def of_sb3() -> Figure:
    """Draw how much of the fooling set PPO's queries reach, by the proposals of an episode."""
    figure = new_figure(5.4, 2.8)
    axes = figure.subplots()
    for horizon, colour, marker in ((1, UNHURT, "s"), (8, FOOLED, "o")):
        label = f"horizon={horizon}"
        axes.plot(QUERIES, REACHED[horizon], marker=marker, color=colour, label=label)
    axes.set_xscale("log")
    axes.set_xticks(QUERIES, labels=[f"{one:,}" for one in QUERIES])
    axes.minorticks_off()
    axes.set(xlabel="queries", ylabel="fooling set reached, %", ylim=(0, 102))
    axes.legend(frameon=False, fontsize=9)
    tidy(axes, grid="y")
    return figure


def of_worst_return() -> Figure:
    """Draw the lowest return that each search found, by the number of parameters."""
    figure = new_figure(8.2, 3.0)
    panels = figure.subplots(1, 3, sharey=True)
    whole, tenth = (one for one in tables(DOCS / "worst-return.md") if one[0][0] == "search")
    names = [row[0] for row in whole[1:]]
    for table, filled, shift in ((whole, True, -0.15), (tenth, False, 0.15)):
        for column, heading in enumerate(table[0][1:], 1):
            axes = panels[int(heading[0]) - 1]
            for name, *cells in table[1:]:
                if cells[column - 1] == "-":
                    continue
                mean, spread = map(float, cells[column - 1].replace(",", "").split("±"))
                place = names.index(name) + shift
                colour = FOOLED if name == "bayesian" else UNHURT if "grid" in name else MUTED
                ends = (max(1.0, mean - spread), mean + spread)
                axes.plot(ends, (place, place), color=colour, lw=1.6, alpha=0.6)
                face = colour if filled else "none"
                axes.plot(mean, place, "o", ms=7, mec=colour, mfc=face)
    for k, axes in enumerate(panels, 1):
        axes.set_title(f"{k} parameter{'s' * (k > 1)}", fontsize=10, color=INK, loc="left")
        axes.set(xlabel="return (log)", xscale="log", xlim=(180, 4_000))
        ticks = (200, 400, 800, 1_600, 3_200)
        axes.set_xticks(ticks, labels=[f"{tick:,}" for tick in ticks])
        axes.minorticks_off()
        tidy(axes)
    panels[0].set_yticks(range(len(names)), labels=names)
    panels[0].invert_yaxis()
    return figure


def of_scale() -> Figure:
    """Draw AFR and coverage of the adversaries that use the values of Q, by the scale of Q."""
    (_, *scales), *rows = named(DOCS / "adversaries" / "scale.md", "rank Q")
    figure = new_figure(7.2, 2.4)
    panels = figure.subplots(1, 2, sharey=True)
    colours = (FOOLED, UNHURT, MUTED, INK)
    for k, axes in enumerate(panels):
        for column, (scale, marker) in enumerate(zip(scales, "os^D", strict=True)):
            values = [float(row[1 + column].split("/")[k]) for row in rows]
            places = [place + 0.16 * (column - 1.5) for place in range(len(rows))]
            shown = {"color": colours[column], "ms": 6, "label": scale}
            axes.plot(values, places, marker, **shown)
        axes.set(xlabel=("AFR, %", "coverage, % of ideal samples'")[k], xlim=(0, 105))
        tidy(axes, grid="both")
    panels[0].set_yticks(range(len(rows)), labels=[row[0] for row in rows])
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


@own_style()
def main() -> None:
    """Draw them all."""
    drawn = {
        "repair": of_repair(),
        "diagnosis": of_diagnosis(),
        "sb3": of_sb3(),
        "scale": of_scale(),
        "worst-return": of_worst_return(),
    }
    for name, figure in drawn.items():
        (DOCS / "images" / f"{name}.svg").write_bytes(svg(figure))


if __name__ == "__main__":
    main()
