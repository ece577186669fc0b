"""How often the tables' 95 % intervals hold the true mean.

    python -m studies.intervals

Each simulation draws figures for some tracks with some seeds each: the tracks' means are fixed, and
the seeds differ by a normal error. A quarter of a minute of one core.
"""

from __future__ import annotations

import numpy as np

from sada_gym.measures.statistics import estimate

TRACKS = (1, 3, 6, 12)
SEEDS = (3, 5, 10)
SIMULATIONS = 1_000
ERROR = 0.1


def share_held(tracks: int, seeds: int, simulations: int = SIMULATIONS) -> float:
    """Return in which share of the simulations the interval holds the true mean."""
    rng = np.random.default_rng((tracks, seeds))
    means = np.linspace(0.55, 0.85, tracks)
    hits = 0
    for i in range(simulations):
        figures = rng.normal(means[:, None], ERROR, (tracks, seeds))
        interval = estimate(figures, seed=i, resamples=1_000).interval
        assert interval is not None
        hits += interval[0] <= means.mean() <= interval[1]
    return hits / simulations


def main() -> None:
    print("| tracks |", *(f"{seeds} seeds |" for seeds in SEEDS))
    print("| --- |" + " --- |" * len(SEEDS))
    for tracks in TRACKS:
        shares = (f"{100 * share_held(tracks, seeds):.0f} |" for seeds in SEEDS)
        print(f"| {tracks} |", *shares)


if __name__ == "__main__":
    main()
