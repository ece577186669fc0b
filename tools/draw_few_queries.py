"""Draw F1 of adversaries by the number of queries: few-queries.svg and many-dimensions.svg.

    python -m tools.draw_few_queries

From the runs that `studies.few_queries` and `studies.many_dimensions` kept; each line is a mean
over their seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sada_gym.analyses.plots.style import new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import MUTED, SKY, VERMILLION
from studies import few_queries, many_dimensions

IMAGES = Path(__file__).parents[1] / "docs" / "images"
LINES = {
    "random": (MUTED, "s"),
    "bbgan": ("#8f6bb3", "^"),
    "gp": ("#3d9970", "v"),
    "trees": (SKY, "D"),
    "smc": ("#b58900", "P"),
    "level-set": (VERMILLION, "o"),
}
"""The colour and the marker of each adversary that is drawn."""


@own_style()
def draw(name: str, means: dict[str, dict[str, dict[int, float]]], budgets: Sequence[int]) -> None:
    """Draw a panel for each title of `means`, which has F1 by adversary and budget."""
    columns = 4
    rows = -(-len(means) // columns)
    figure = new_figure(2.1 * columns, 2.3 * rows + 0.5)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axes, (title, mean) in zip(panels, means.items(), strict=False):
        for adversary, (colour, marker) in LINES.items():
            if by_budget := mean.get(adversary):
                axes.plot(
                    list(by_budget),
                    list(by_budget.values()),
                    color=colour,
                    marker=marker,
                    markersize=5,
                    linewidth=2.4 if adversary == "level-set" else 1.4,
                    label=adversary,
                )
        axes.set_title(title, fontsize=11)
        axes.set_xscale("log", base=2)
        axes.set_xticks(budgets, labels=[f"{budget:,}" for budget in budgets])
        axes.set(ylim=(0.1, 1.03), xlabel="queries")
        tidy(axes)
    for axes in panels[len(means) :]:
        axes.remove()
    for axes in panels[::columns]:
        axes.set_ylabel("F1")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6, frameon=False, fontsize=11)
    (IMAGES / f"{name}.svg").write_bytes(svg(figure))


def main() -> None:
    """Draw both charts, with a panel for each track or problem that has been measured."""
    tracks = (*few_queries.CHOOSE, *few_queries.JUDGE)
    of_track = {track[5:-3]: found for track in tracks if (found := few_queries.means(track))}
    for mean in of_track.values():
        mean.pop("smc", None)  # on digits alone
    draw("few-queries", of_track, few_queries.BUDGETS)
    problems = [name for names in many_dimensions.BY_DIMENSION.values() for name in names]
    of_problem = {one: found for one in problems if (found := many_dimensions.means(one))}
    draw("many-dimensions", of_problem, many_dimensions.BUDGETS)


if __name__ == "__main__":
    main()
