"""A small application and adversary that any process can import, for the oracle's tests."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.application import Application, Scored
from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.foundations.frames import Frame
from sada_gym.parameters import Mu, Parameter, ParameterSpace


class Toy(Application):
    """Q grows with the distance to a point, with noise by the seed.

    Args:
        dimension: d.
        pause_s: Sleep in each evaluation.
        log: A file that each evaluation appends its process and seed to.
        offset: A setting that changes the score.
        agent_id: The fingerprint.
        version: The version.
        fail_above: Raise where mu[0] is above this.
    """

    name = "Toy"
    fooling_threshold = 0.3
    sample_size = 20

    def __init__(
        self,
        dimension: int = 3,
        *,
        pause_s: float = 0.0,
        log: str | None = None,
        offset: float = 0.0,
        agent_id: str | None = "toy",
        version: int = 0,
        fail_above: float = 1.0,
    ) -> None:
        self.parameters = ParameterSpace(
            *(Parameter(f"angle{i}_deg", -90.0, 90.0, "deg") for i in range(dimension))
        )
        self.pause_s, self.log, self.offset = pause_s, log, offset
        self.agent_id = agent_id
        self.version = version  # type: ignore[misc]
        self.fail_above = fail_above

    @property
    def settings(self) -> dict[str, Any]:
        return {"dimension": len(self.parameters), "offset": self.offset}

    @property
    def fingerprint(self) -> str | None:
        return self.agent_id

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        return Scored(
            np.array([self._one(m, s) for m, s in zip(mu, seeds, strict=True)]), [{}] * len(mu)
        )

    def _one(self, mu: npt.NDArray[np.float32], seed: int) -> float:
        time.sleep(self.pause_s)
        if mu[0] > self.fail_above:
            raise RuntimeError("the world collapsed")
        if self.log is not None:
            with Path(self.log).open("a") as file:
                file.write(f"{os.getpid()} {seed}\n")
        noise = 0.1 * np.random.default_rng(seed).random()
        return min(1.0, float(np.linalg.norm(mu - 0.4)) / 2 + noise + self.offset)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        frame = np.full((48, 64, 3), seed % 255, dtype=np.uint8)
        frame[..., 0] = int(127 * (np.asarray(mu)[0] + 1))
        return frame


class Blind(Toy):
    """It draws no pictures."""

    render = Application.render


class ToyEnv(AdversaryEnv):
    """`Toy` by id: `toy:Toy-v0`."""

    def __init__(self, *, pause_s: float = 0.0, log: str | None = None) -> None:
        super().__init__(Toy(pause_s=pause_s, log=log))


if "Toy-v0" not in gym.registry:
    gym.register("Toy-v0", entry_point="toy:ToyEnv")


class Greedy(Adversary):
    """A normal distribution around the lowest scores, found in two rounds."""

    name: ClassVar[str] = "greedy"

    def __init__(self, dimension: int, *, seed: int | None = None, best: int = 20) -> None:
        super().__init__(dimension, seed=seed)
        self.best = best

    def train(self, oracle: Query) -> None:
        half = oracle.remaining // 2
        mu = self.rng.uniform(-1, 1, (half, self.dimension)).astype(np.float32)
        q = oracle(mu)
        self.fit(mu, q)
        more = self.sample(oracle.remaining)
        self.fit(np.concatenate([mu, more]), np.concatenate([q, oracle(more)]))

    def fit(self, mu: Mu, q: npt.NDArray[np.float64]) -> None:
        lowest = mu[np.argsort(q, kind="stable")[: self.best]]
        self.mean, self.std = lowest.mean(axis=0), lowest.std(axis=0)

    def sample(self, n: int) -> npt.NDArray[np.float32]:
        drawn = self.rng.normal(self.mean, self.std, (n, self.dimension))
        return np.clip(drawn, -1, 1).astype(np.float32)

    def save(self, folder: Path) -> None:
        np.savez(folder / "normal.npz", mean=self.mean, std=self.std)

    @classmethod
    def load(cls, folder: Path) -> Self:
        raise NotImplementedError


def paraboloid(mu: Mu) -> npt.NDArray[np.float64]:
    """Return a batch function's scores."""
    return np.asarray((mu.astype(np.float64) ** 2).mean(axis=1))
