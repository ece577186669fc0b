"""Which fool more often after the uniform queries: mu close to hits, or the level set?

    python -m studies.hits_and_level_set SADA-UAV-5Anchors-v0 SADA-Detection-Car-v0 spots-5-75-10

This is the trial of `level-set`, with 250 worlds each instead of 5 % of the budget: how its bounds
were chosen. A track is an environment's id, or one of `designs.py`. Each has 400 uniform queries;
the detection tracks 800, as their budget is 2,000.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.level_set import LevelSet
from sada_gym.adversaries.query_pool import evaluate_uniform
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations
from studies.designs import load

EACH, POOL = 250, 20_000


class Trial(LevelSet):
    """Keeps the queries of its trial, and what was predicted of them."""

    def tried(self, uniform: int, oracle: Query) -> tuple[float, Evaluations, list[float]]:
        """Return the rate of uniform queries; the queries of the trial; and two predicted rates."""
        self.threshold, self._permits = oracle.threshold, getattr(oracle, "permits", None)
        queries = evaluate_uniform(uniform, self.dimension, oracle, self.rng)
        surrogate = self._fit_surrogate(queries, self.rng)
        pool = self._uniform(POOL)
        tried = self._try_hits(queries, surrogate, pool, surrogate(pool), EACH, oracle)
        predicted = surrogate(tried.mu)
        rate = float(queries.fooled(self.threshold).mean())
        return rate, tried, [float(predicted[part].mean()) for part in PARTS]


PARTS = (slice(EACH), slice(EACH, None))


def rows(names: list[str], seeds: list[int]) -> Iterator[str]:
    """Yield the rows of the table."""
    for name in names:
        for seed in seeds:
            uniform = 800 if name.startswith("SADA-Detection") else 400
            if name.startswith("SADA-"):
                evaluator = Evaluator(name, workers=1)
                dimension = evaluator.dimension
                oracle: Query = Oracle(evaluator, budget=uniform + 2 * EACH, seed=seed)
            else:
                track = load(name, 1)
                dimension, oracle = track.dimension, track.oracle(seed, uniform + 2 * EACH)
            adversary = Trial(dimension, seed=seed)
            rate, tried, predicted = adversary.tried(uniform, oracle)
            fooled = tried.fooled(adversary.threshold)
            rates = [float(fooled[part].mean()) for part in PARTS]
            shown = [
                f"{100 * rate:.0f} ({100 * was:.0f})"
                for rate, was in zip(rates, predicted, strict=True)
            ]
            gap = f"{100 * (rates[0] - rates[1]):+.0f}"
            pays = "yes" if adversary.hits_pay else "no"
            yield (
                "| " + " | ".join([name, str(seed), f"{100 * rate:.0f}", *shown, gap, pays]) + " |"
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("tracks", nargs="+")
    parser.add_argument("--seeds", type=int, nargs="*", default=[0])
    given = parser.parse_args()
    print(
        "| track | seed | uniform | beside hits (predicted) | level set (predicted) | gap | pay |"
    )
    print("| --- " * 7 + "|")
    for row in rows(given.tracks, given.seeds):
        print(row, flush=True)


if __name__ == "__main__":
    main()
