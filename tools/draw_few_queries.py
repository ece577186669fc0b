"""Draw docs/images/few-queries.svg: F1 of five adversaries by the number of queries.

    python -m tools.draw_few_queries

From the runs that `studies.few_queries` kept; each line is a mean over their seeds.
"""

from __future__ import annotations

from pathlib import Path

from sada_gym.analyses.plots.style import new_figure, svg, tidy
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import MUTED, SKY, VERMILLION
from studies.few_queries import BUDGETS, CHOOSE, COLUMNS, JUDGE, means

OUT = Path(__file__).parents[1] / "docs" / "images" / "few-queries.svg"
COLOURS = dict(zip(COLUMNS, (MUTED, "#8f6bb3", "#3d9970", SKY, VERMILLION), strict=True))
MARKERS = dict(zip(COLUMNS, "s^vDo", strict=True))


@own_style()
def main() -> None:
    """Draw a panel for each track that has been measured, five in a row."""
    of_track = {track: found for track in (*CHOOSE, *JUDGE) if (found := means(track))}
    rows = -(-len(of_track) // 5)
    figure = new_figure(12.0, 2.9 * rows + 0.5)
    panels = figure.subplots(rows, 5, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (track, mean) in zip(panels, of_track.items(), strict=False):
        for name in COLUMNS:
            if by_budget := mean.get(name):
                axes.plot(
                    list(by_budget),
                    list(by_budget.values()),
                    color=COLOURS[name],
                    marker=MARKERS[name],
                    markersize=5,
                    linewidth=2.4 if name == "level-set" else 1.4,
                    label=name,
                )
        axes.set_title(track[5:-3], fontsize=11)
        axes.set_xscale("log", base=2)
        axes.set_xticks(BUDGETS, labels=[f"{budget}" for budget in BUDGETS])
        axes.set(ylim=(0.0, 1.03), xlabel="queries")
        tidy(axes)
    for axes in panels[len(of_track) :]:
        axes.remove()
    for axes in panels[::5]:
        axes.set_ylabel("F1")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, fontsize=11)
    OUT.write_bytes(svg(figure))


if __name__ == "__main__":
    main()
