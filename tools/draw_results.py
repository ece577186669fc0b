"""Draw the charts of recorded results in docs/images, each from a table that a page or study has.

python -m tools.draw_results
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from sada_gym.analyses.plots.style import FOOLED, UNHURT, new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
DOCS, IMAGES = ROOT / "docs", ROOT / "docs" / "images"
ADVERSARIES, STUDIES = DOCS / "adversaries", ROOT / "studies"
MARKS = "osD^v"
ON_ORANGE = "#111111"  # in the dark, too
COLOURS = (FOOLED, UNHURT, MUTED, INK, "#009e73")
Table = dict[str, list[str]]


def tables(page: Path) -> list[list[list[str]]]:
    """Return the cells of each table of a page, its heading first, without marks of Markdown."""
    blocks = re.findall(r"(?:^\|.*\|\n)+", page.read_text("utf-8"), re.MULTILINE)
    plain = [re.sub(r"[*`]", "", block).splitlines() for block in blocks]
    rows = [[[c.strip() for c in line[1:-1].split("|")] for line in lines] for lines in plain]
    return [[found[0], *found[2:]] for found in rows]


def named(page: Path, heading: str) -> list[list[str]]:
    """Return the first table of a page with a heading of this name among its columns."""
    return next(table for table in tables(page) if heading in table[0])


def write_values(
    axes: Axes, texts: list[str], values: list[float], gap: float, **look: object
) -> None:
    """Write a text beside each value, so many points to its right; value i is at height i."""
    for place, (text, value) in enumerate(zip(texts, values, strict=True)):
        offset = {"xytext": (gap, 0), "textcoords": "offset points"}
        axes.annotate(text, (value, place), va="center", **offset, **look)


def bars(
    axes: Axes, labels: list[str], values: list[float], form: str, ink: str = INK, **look: object
) -> None:
    """Draw horizontal bars from the top down, each with its value."""
    places = range(len(labels))
    axes.barh(places, values, **look)
    write_values(axes, [f"{value:{form}}" for value in values], values, 4, fontsize=8, color=ink)
    axes.set_yticks(places, labels=labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)


def by_dimension() -> Figure:
    """Draw the criterion over the number of dimensions, from the study's tables."""
    found: dict[str, list[float]] = {}
    dimensions = (2, 5, 8, 12)
    compared = [
        table
        for table in tables(ROOT / "studies" / "level_set_tables.md")
        if table[0][1].startswith("smooth-")
    ]
    for table in compared:
        for label, *_, criterion in table[1:]:
            found.setdefault(label, []).append(float(criterion))
    figure = new_figure(7.2, 3.6)
    axes = figure.subplots()
    shown = ("level-set", "smc", "memorise", "trees", "level-set, no hits", "random")
    ends = []
    for i, label in enumerate(shown):
        colour = (FOOLED, "#009e73", MUTED, UNHURT, FOOLED, INK)[i]
        width = 2.6 if label == "level-set" else 1.4
        style = {"level-set, no hits": "--", "random": ":"}.get(label, "-")
        axes.plot(dimensions, found[label], style, color=colour, lw=width, marker="o", ms=4)
        ends.append((found[label][-1], label, colour))
    height = 1.0
    for value, label, colour in sorted(ends, reverse=True):
        height = min(height - 0.045, value)
        axes.text(12.3, height, label, va="center", fontsize=9, color=colour)
    axes.set(xlabel="dimensions", ylabel="criterion", xlim=(1.5, 15.8), ylim=(0, 0.8))
    axes.set_xticks(dimensions)
    tidy(axes, grid="y")
    return figure


def of_rl() -> Figure:
    """Draw AFR and coverage of adversaries, a mark for each application."""
    (_, *applications), *rows = named(DOCS / "results" / "rl.md", "Robot")
    figure = new_figure(7.2, 3.5)
    panels = figure.subplots(1, 2, sharey=True)
    for k, axes in enumerate(panels):
        for column, application in enumerate(applications):
            values = [float(row[1 + column].split("/")[k]) for row in rows]
            axes.plot(
                values,
                range(len(rows)),
                MARKS[column],
                color=COLOURS[column],
                ms=6,
                alpha=0.85,
                label=application,
            )
        axes.set(xlabel=("AFR, %", "coverage, % of ideal samples'")[k], xlim=(0, 105))
        tidy(axes, grid="both")
    panels[0].set_yticks(range(len(rows)), labels=[row[0] for row in rows])
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, fontsize=8)
    return figure


def of_agents() -> Figure:
    """Draw how often agents fail in random worlds and against an adversary, a line between."""
    heading, *rows = named(DOCS / "results" / "agents.md", "agent")
    figure = new_figure(6.2, 3.8)
    axes = figure.subplots()
    shown = (("random", UNHURT, "o", "random worlds"), ("level-set", FOOLED, "D", "level-set"))
    rates = [[float(row[heading.index(name)]) for row in rows] for name, *_ in shown]
    for place, ends in enumerate(zip(*rates, strict=True)):
        axes.plot(ends, (place, place), color=MUTED, lw=1.2, zorder=1)
    for values, (_, colour, mark, label), side in zip(rates, shown, ("right", "left"), strict=True):
        axes.plot(values, range(len(rows)), mark, color=colour, ms=8, label=label)
        for place, value in enumerate(values):
            at = value + (2.5 if side == "left" else -2.5)
            axes.text(at, place, f"{value:g}", ha=side, va="center", fontsize=9, color=INK)
    axes.set(xlabel="worlds in which the agent fails, %", xlim=(0, 112), xticks=range(0, 101, 20))
    axes.set_yticks(range(len(rows)), labels=[f"{row[1]} ({row[0].lower()})" for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False, fontsize=9)
    tidy(axes, grid="both")
    return figure


def of_tools() -> Figure:
    """Draw AFR over coverage of what people usually use."""
    heading, *rows = named(DOCS / "comparison.md", "what people use")
    figure = new_figure(7.2, 3.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, column in zip(panels, (2, 3), strict=True):
        for row in rows:
            if "/" not in row[column]:
                continue
            afr, coverage = map(float, row[column].split("/"))
            ours = row[1] == "level-set"
            axes.plot(coverage, afr, "o", ms=8, color=FOOLED if ours else MUTED)
            left = coverage > 55
            side = "right" if left else "left"
            gap, down = (
                (-3 if left else 3),
                (-5 if row[1] in ("cma-mae", "tpe", "bbgan", "bbgan (paper)") else 0),
            )
            axes.text(
                coverage + gap,
                afr + down,
                row[1],
                ha=side,
                va="center",
                fontsize=9,
                color=FOOLED if ours else INK,
                weight="bold" if ours else "normal",
            )
        axes.set_title(heading[column].split(":")[0], fontsize=9, color=MUTED, loc="left")
        axes.set(xlabel="coverage, % of ideal samples'", xlim=(-2, 106), ylim=(0, 106))
        tidy(axes, grid="both")
    panels[0].set_ylabel("samples that fool the agent (AFR), %")
    return figure


def of_paper() -> Figure:
    """Draw the AFR of ours and of the paper's adversaries on the columns of its Table 1."""
    heading, *rows = named(DOCS / "results" / "table-1" / "table.md", "12-class avg")
    paper = [row for row in rows if any("/" in cell for cell in row) or row[0] == "ideal"]
    rows = [row for row in paper if row[0] != "full set"]
    figure = new_figure(9.6, 5.6)
    panels = figure.subplots(2, 5, sharex=True, sharey=True).flat
    for column, axes in enumerate(panels, 1):
        for place, row in enumerate(rows):
            rates = [float(cell) for cell in row[column].split("/")]
            axes.plot(rates, [place] * len(rates), color=MUTED, lw=1)
            axes.plot(rates[0], place, "o", color=FOOLED, ms=6, label="ours")
            axes.plot(rates[1:], [place] * (len(rates) - 1), "D", color=UNHURT, ms=5, label="paper")
        axes.set_title(heading[column], fontsize=9, color=INK, loc="left")
        axes.set(xlim=(0, 105), xticks=(0, 50, 100))
        tidy(axes, grid="both")
    axes.set_yticks(range(len(rows)), labels=[row[0] for row in rows])
    axes.invert_yaxis()
    handles, _ = axes.get_legend_handles_labels()
    figure.legend(
        handles[:2], ["ours", "the paper's"], loc="outside upper right", ncols=2, frameon=False
    )
    figure.supxlabel("AFR, %", fontsize=10, color=INK)
    return figure


def of_parameters() -> Figure:
    """Draw the total Sobol indices of the detector's parameters and of the driver's."""
    page = DOCS / "results" / "parameters.md"
    detector = [row for row in named(page, "total, lowest class")[1:] if "planted" not in row[0]]
    driver = [row for row in named(page, "task")[1:] if "planted" not in row[0]]
    figure = new_figure(6.2, 5.2)
    left, right = figure.subplots(2, 1, height_ratios=(len(detector), len(driver)))
    labels = [row[0].removesuffix("_deg").replace("_", " ") for row in detector]
    bars(left, labels, [float(row[2]) for row in detector], ".2f", color=FOOLED)
    left.set_title("detector", fontsize=10, color=INK, loc="left")
    words = [re.sub(r"_(m|deg)$", "", row[0]).replace("_", " ") for row in driver]
    names = [f"{word}, {row[1]}" for word, row in zip(words, driver, strict=True)]
    bars(right, names, [float(row[4]) for row in driver], ".2f", color=UNHURT)
    right.set_title("driver", fontsize=10, color=INK, loc="left")
    for axes in (left, right):
        axes.set(xlim=(0, 1.08))
        tidy(axes)
    right.set_xlabel("total Sobol index")
    return figure


def of_speed() -> Figure:
    """Draw how long the evaluations of an attack take on each application."""
    heading, *rows = named(DOCS / "results" / "speed.md", "500 queries and M samples")
    column = heading.index("500 queries and M samples")
    figure = new_figure(6.2, 2.4)
    axes = figure.subplots()
    seconds = [float(row[column].removesuffix(" s")) for row in rows]
    axes.plot(seconds, range(len(rows)), "o", color=UNHURT, ms=8)
    write_values(axes, [f"{value:g} s" for value in seconds], seconds, 8, color=INK)
    axes.set_yticks(range(len(rows)), labels=[row[0] for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set(xscale="log", xlabel="seconds on one core, evaluations only", xlim=(0.05, 300))
    axes.set_xticks((0.1, 1, 10, 100), labels=("0.1", "1", "10", "100"))
    tidy(axes)
    return figure


def of_pitch() -> Figure:
    """Draw how often the driver fails, by the camera's pitch and height."""
    heading, *rows = named(DOCS / "results" / "parameters.md", "camera")
    figure = new_figure(7.2, 2.9)
    axes = figure.subplots()
    rates = [[float(cell.removesuffix("%")) for cell in row[2:]] for row in rows]
    axes.imshow(rates, cmap="Oranges", vmin=0, vmax=130, aspect="auto")
    for i, row in enumerate(rates):
        for j, rate in enumerate(row):
            axes.text(j, i, f"{rate:.0f} %", ha="center", va="center", fontsize=9, color=ON_ORANGE)
    axes.set_xticks(range(len(heading) - 2), labels=heading[2:])
    axes.set_yticks(range(len(rows)), labels=[f"{row[0]}, camera {row[1]}" for row in rows])
    axes.set_xlabel("camera pitch")
    tidy(axes)
    return figure


def of_designs(page: Path, column: str = "criterion") -> Figure:
    """Draw the designs' criterion, from the first table with this column; defaults in colour."""
    default = set(re.findall(r"^\| \*\*(.+?)\*\*", page.read_text("utf-8"), re.MULTILINE))
    heading, *rows = named(page, column)
    rows = [row for row in rows if row[0] != "ideal samples"]
    criterion = heading.index("criterion")
    figure = new_figure(7.2, 0.6 + 0.21 * len(rows))
    axes = figure.subplots()
    colours = [FOOLED if row[0] in default else UNHURT for row in rows]
    labels = [row[0] for row in rows]
    bars(axes, labels, [float(row[criterion]) for row in rows], ".2f", color=colours)
    axes.set(xlabel="criterion (1: as good as ideal samples)", xlim=(0, 1))
    tidy(axes)
    return figure


def of_parking() -> Figure:
    """Draw the failures that the searches on parking find, with their intervals."""
    heading, *rows = named(DOCS / "parking.md", "knows the training log")
    figure = new_figure(7.2, 2.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, worlds in zip(panels, (100, 400), strict=True):
        cells = [row[heading.index(f"failures of {worlds}")] for row in rows]
        values, errors = ([float(cell.split("±")[k]) for cell in cells] for k in (0, 1))
        colours = [UNHURT if row[1] == "yes" else FOOLED for row in rows]
        look = {"ecolor": MUTED, "capsize": 3, "height": 0.7}
        axes.barh(range(len(rows)), values, xerr=errors, color=colours, **look)
        axes.set(xlabel=f"failures of {worlds} worlds", xlim=(0, 0.62 * worlds))
        tidy(axes)
    names = [f"{row[0]} (knows the log)" if row[1] == "yes" else row[0] for row in rows]
    panels[0].set_yticks(range(len(rows)), labels=names)
    panels[0].invert_yaxis()
    return figure


@own_style()
def main() -> None:
    """Draw them all."""
    drawn = {
        "level-set-dimensions": by_dimension(),
        "results-rl": of_rl(),
        "results-agents": of_agents(),
        "results-paper": of_paper(),
        "results-parameters": of_parameters(),
        "results-pitch": of_pitch(),
        "results-speed": of_speed(),
        "comparison": of_tools(),
        "designs-bbgan": of_designs(ADVERSARIES / "appendix-bbgan.md"),
        "designs-level-set": of_designs(STUDIES / "level_set_tables.md", "Chair:surveyor"),
        "designs-rl": of_designs(ADVERSARIES / "appendix-reinforcement-learning.md"),
        "parking": of_parking(),
    }
    for name, figure in drawn.items():
        (IMAGES / f"{name}.svg").write_bytes(svg(figure))


if __name__ == "__main__":
    main()
