"""Compare designs of BBGAN on training tracks: how its defaults were chosen.

    python benchmarks/bbgan_defaults.py --seeds 2

The tracks are analytic boxes and synthetic landscapes with a random world; no environment of the
leaderboard is among them. Each design learns from N = 2,000 uniform queries. Then 500 samples are
held against points that it never saw:

- AFR: the samples' mean true fooling rate, in %.
- coverage (Naeem et al. 2020, k = 5): the share of held-out points of the fooling set
  {mu: P(Q <= threshold) >= 0.5} that have a fooling sample within the distance to their fifth
  nearest neighbour; as a share of what as many ideal samples (uniform over the set) reach.

The criterion is the mean over tracks and seeds of AFR / ideal samples' AFR x coverage, the first
factor at most 1: a design has to fool, and to cover.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from sada_gym import adversaries
from sada_gym.envs.analytic import AnalyticApplication

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "adversaries"))
from landscape import FunctionOracle, Landscape

BUDGET, SAMPLES, NEIGHBOURS, DRAWS = 2_000, 500, 5, 4
Rate = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float64]]

DESIGNS: dict[str, tuple[str, dict[str, Any]]] = {
    "random": ("random", {}),
    "paper preset": ("bbgan", {"preset": "paper"}),
    "paper preset, boosted": ("bbgan-boost", {"preset": "paper"}),
    "**default**": ("bbgan", {}),
    "without the rest of Omega": ("bbgan", {"rest": 0.0}),
    "without a tether": ("bbgan", {"tether": 0.0}),
    "without Fourier features": ("bbgan", {"features": 0}),
    "G of z alone (no transport)": ("bbgan", {"transport": False, "tether": 0.0}),
    "without refusals": ("bbgan", {"acceptance": 0.0}),
    "s = 100": ("bbgan", {"induced_size": 100}),
    "**default, boosted**": ("bbgan-boost", {}),
}


def tracks() -> dict[str, tuple[int, Callable[[], Any], Rate]]:
    """Give each track's dimension, a maker of its score function, and its true fooling rate."""
    found: dict[str, tuple[int, Callable[[], Any], Rate]] = {}
    for d in (2, 5, 8):
        application = AnalyticApplication(dimension=d)

        def score(mu: Any, application: AnalyticApplication = application) -> Any:
            return application.evaluate(mu, range(len(mu))).score

        def rate(mu: Any, application: AnalyticApplication = application) -> Any:
            return (application.fooling_region(mu) >= 0).astype(np.float64)

        found[f"boxes {d}-d"] = (d, lambda score=score: score, rate)  # type: ignore[misc]
    for name, seed, share in (("waves 8-d, 35 %", 0, 0.35), ("waves 8-d, 20 %", 1, 0.2)):
        known = Landscape(seed, rate=share)

        def make(seed: int = seed, share: float = share) -> Landscape:
            return Landscape(seed, rate=share)

        found[name] = (8, make, known.fooling_rate)
    return found


class Reference:
    """Held-out points of a track's fooling set, and what ideal samples reach."""

    def __init__(self, dimension: int, rate: Rate) -> None:
        self.rate = rate
        rng = np.random.default_rng(12345)
        mu = rng.uniform(-1.0, 1.0, (60_000, dimension)).astype(np.float32)
        self.fooling = mu[rate(mu) >= 0.5]
        picks = [rng.choice(len(self.fooling), (2, SAMPLES), replace=False) for _ in range(DRAWS)]
        self.sets = [self.fooling[real] for real, _ in picks]
        ideal = [self.fooling[fake] for _, fake in picks]
        self.ideal_afr = float(np.mean([rate(mu).mean() for mu in ideal]))
        self.ideal_coverage = float(np.mean([self._covered(mu) for mu in ideal]))

    def measure(self, mu: npt.NDArray[np.float32]) -> tuple[float, float]:
        """Give AFR and coverage of samples."""
        rate = self.rate(mu)
        return float(rate.mean()), self._covered(mu[rate >= 0.5]) / self.ideal_coverage

    def _covered(self, fooling: npt.NDArray[np.float32]) -> float:
        if not len(fooling):
            return 0.0
        shares = []
        for real in self.sets:
            radius = KDTree(real).query(real, NEIGHBOURS + 1)[0][:, -1]
            shares.append((KDTree(fooling).query(real)[0] <= radius).mean())
        return float(np.mean(shares))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--designs", nargs="*", default=list(DESIGNS), choices=list(DESIGNS))
    chosen = parser.parse_args()
    problems = tracks()
    references = {name: Reference(d, rate) for name, (d, _, rate) in problems.items()}
    print("| design |", *(f"{name} |" for name in problems), "criterion | s a training |")
    print("| --- |", *("--- |" for _ in problems), "--- | --- |")
    ideal = [f"{100 * r.ideal_afr:.0f} / 1.00 |" for r in references.values()]
    print("| ideal samples |", *ideal, "1.00 | |", flush=True)
    for design in chosen.designs:
        kind, options = DESIGNS[design]
        cells, merits, seconds = [], [], 0.0
        for name, (d, make, _) in problems.items():
            figures = []
            for seed in range(chosen.seeds):
                adversary = adversaries.make(kind, d, seed=seed, **options)
                start = time.perf_counter()
                adversary.train(FunctionOracle(make(), BUDGET))
                seconds += time.perf_counter() - start
                afr, coverage = references[name].measure(adversary.sample(SAMPLES))
                figures.append((afr, coverage))
                merits.append(min(afr / references[name].ideal_afr, 1.0) * min(coverage, 1.0))
            afr, coverage = np.mean(figures, axis=0)
            cells.append(f"{100 * afr:.0f} / {coverage:.2f} |")
        print(
            f"| {design} |",
            *cells,
            f"{np.mean(merits):.2f} | {seconds / len(merits):.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
