"""An adversary of your own: it samples around the worlds that fooled the agent.

Run it: python examples/own_adversary.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import sada_gym
from sada_gym import Oracle
from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform
from sada_gym.evaluations import Evaluations
from sada_gym.measures.rates import attack_fooling_rate


@dataclass(frozen=True)
class NeighbourhoodOptions(Options):
    """The options of `Neighbourhood`.

    Attributes:
        width: Standard deviation of each normal distribution.
        least: Number of queries kept where fewer fooled the agent: those of the lowest scores.
    """

    width: float = option(0.05, 0.001, 1)
    least: int = option(10, 1, 1_000)


class Neighbourhood(FittedAdversary):
    """A normal distribution around each query that fooled the agent."""

    name = "neighbourhood"
    options_class = NeighbourhoodOptions
    options: NeighbourhoodOptions

    def query(self, oracle: Query) -> Evaluations:
        """Spend half of the budget on uniform mu, the rest on samples around what they found."""
        half = max(1, oracle.remaining // 2)
        queries = evaluate_uniform(half, self.dimension, oracle, self.rng)
        self.fit(queries)
        closer = self.draw(oracle.remaining).astype(np.float32)
        return queries + evaluate(closer, oracle)

    def fit(self, queries: Evaluations) -> None:
        """Learn from all queries: keep those that fooled."""
        fooled = int(queries.fooled(self.threshold).sum())
        lowest = np.argsort(queries.score, kind="stable")
        self.kept = queries.mu[lowest[: max(fooled, self.options.least)]]

    def draw(self, n: int) -> np.ndarray:
        """Draw n mu, (n, d)."""
        around = self.kept[self.rng.integers(len(self.kept), size=n)]
        # reflected at the sides of the box
        return reflect(around + self.options.width * self.rng.normal(size=around.shape))


def main() -> None:
    """Attack the analytic application, whose fooling set is known."""
    adversary = Neighbourhood(2, seed=0)
    with Oracle("SADA-Analytic-v0", budget=1_000, seed=0) as oracle:
        adversary.train(oracle)
    mu = adversary.sample(250)
    with Oracle("SADA-Analytic-v0", budget=250, seed=0, stream="test") as test:
        print(f"attack fooling rate: {attack_fooling_rate(test(mu), test.threshold)}")
    region = sada_gym.make_application("SADA-Analytic-v0").fooling_region(mu)  # -1 outside
    print("samples in each of the four regions:", [int((region == i).sum()) for i in range(4)])


if __name__ == "__main__":
    main()
