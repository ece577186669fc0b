"""An adversary of your own: it samples around the worlds that fooled the agent.

Run it: python examples/own_adversary.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from typing_extensions import Self

import sada_gym
from sada_gym.adversaries.base import Adversary, Query
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.oracle import Oracle


class Neighbourhood(Adversary):
    """A normal distribution around each query that fooled the agent.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness.
        width: Standard deviation of each normal distribution.
        least: Number of queries kept where fewer fooled the agent: those of the lowest scores.
    """

    name = "neighbourhood"

    def __init__(
        self, dimension: int, *, seed: int | None = None, width: float = 0.05, least: int = 10
    ) -> None:
        super().__init__(dimension, seed=seed)  # makes self.dimension and self.rng
        self.width, self.least = width, least
        self.kept: np.ndarray | None = None

    def train(self, oracle: Query) -> None:
        """Spend half of the budget on uniform mu, the rest on samples around what they found."""
        half = max(1, oracle.remaining // 2)
        mu = self.rng.uniform(-1.0, 1.0, (half, self.dimension)).astype(np.float32)
        q = oracle(mu)
        self._keep(mu, q, oracle.threshold)
        closer = self.sample(oracle.remaining)
        mu, q = np.concatenate([mu, closer]), np.concatenate([q, oracle(closer)])
        self._keep(mu, q, oracle.threshold)

    def _keep(self, mu: np.ndarray, q: np.ndarray, threshold: float) -> None:
        count = max(int((q <= threshold).sum()), self.least)
        self.kept = mu[np.argsort(q, kind="stable")[:count]]

    def sample(self, n: int) -> np.ndarray:
        """Draw n fresh mu, (n, d) float32."""
        if self.kept is None:
            raise RuntimeError("Expected a trained adversary, got an untrained one. Call train.")
        around = self.kept[self.rng.integers(len(self.kept), size=n)]
        drawn = around + self.width * self.rng.normal(size=around.shape)
        inside = 1.0 - np.abs((drawn + 1.0) % 4.0 - 2.0)  # reflected at the sides of the box
        return inside.astype(np.float32)

    def save(self, folder: Path) -> None:
        """Write what was learnt, and where the generator stands."""
        np.savez(folder / "kept.npz", kept=self.kept)
        state = {"width": self.width, "least": self.least, "rng": self.rng.bit_generator.state}
        (folder / "state.json").write_text(json.dumps(state))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what `save` wrote."""
        with np.load(folder / "kept.npz", allow_pickle=False) as arrays:
            kept = arrays["kept"]
        state = json.loads((folder / "state.json").read_text())
        adversary = cls(kept.shape[1], width=state["width"], least=state["least"])
        adversary.kept = kept
        adversary.rng.bit_generator.state = state["rng"]
        return adversary


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
