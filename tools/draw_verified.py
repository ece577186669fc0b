"""Draw docs/images/verified.png, the claimed AFR of every entry's results over the verified one.

    python -m tools.draw_verified

A dot is a result: one adversary on one track, the mean over its seeds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sada_gym.analyses.plots.style import FOOLED, new_figure, png, tidy
from sada_gym.board.results.entry import EntryResult, read_entries
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.frames import GRID, INK, MUTED

ROOT = Path(__file__).parents[1]
OUT, ENTRIES = ROOT / "docs" / "images" / "verified.png", ROOT / "leaderboard" / "entries"


def rates(result: EntryResult) -> tuple[float, float] | None:
    """Return the verified and the claimed AFR in %; None where there is no verified one."""
    if result.verified is None or not result.verified.seeds:
        return None
    claimed = {claim.seed: claim.measures for claim in result.claimed.seeds if claim.measures}
    pairs = [(seed.measures.afr, claimed[seed.seed].afr) for seed in result.verified.seeds]
    verified, said = np.mean(pairs, axis=0)
    return 100 * float(verified), 100 * float(said)


@own_style()
def main() -> None:
    """Read the entries and draw their results."""
    results = [result for entry in read_entries(ENTRIES) for result in entry.results.values()]
    points = np.array([pair for result in results if (pair := rates(result)) is not None])
    figure = new_figure(6.5, 4.2)
    axes = figure.subplots()
    axes.plot((0, 100), (0, 100), color=GRID, linewidth=2, zorder=0)
    axes.scatter(*points.T, s=14, color=FOOLED, alpha=0.6, linewidths=0)
    above = "a claim that is\ntoo high would\nlie up here"
    axes.text(8, 88, above, color=MUTED, fontsize=10, va="top")
    axes.set(xlabel="verified AFR, %", ylabel="claimed AFR, %", xlim=(0, 101), ylim=(0, 101))
    axes.set_title(
        f"{len(points):,} results of our own entries", fontsize=11, color=INK, loc="left"
    )
    tidy(axes, grid="both")
    apart = np.abs(np.subtract(*points.T))
    most = f"95 % of them at most {np.percentile(apart, 95):.1f} points apart"
    print(f"{len(points)} results, {most}, all at most {apart.max():.1f}")
    OUT.write_bytes(png(figure))


if __name__ == "__main__":
    main()
