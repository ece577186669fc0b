"""The contracts pass what is sound, and catch what is not."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typing_extensions import Self

from sada_gym.adversaries.base import Adversary, Query
from sada_gym.application import Application, Scored
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.parameters import Mu, Parameter, ParameterSpace
from sada_gym.testing import (
    AdversaryContract,
    ApplicationContract,
    RecordingOracle,
    assert_pure,
)
from sada_gym.testing.contracts import Training


class AroundTheBest(Adversary):
    """Samples near the best query; sound."""

    name = "around-the-best"

    def __init__(self, dimension: int, *, seed: int | None = None) -> None:
        super().__init__(dimension, seed=seed)
        self.best: np.ndarray | None = None

    def train(self, oracle: Query) -> None:
        mu = self.rng.uniform(-1, 1, (oracle.remaining, self.dimension)).astype(np.float32)
        self.best = mu[oracle(mu).argmin()]

    def sample(self, n: int) -> np.ndarray:
        if self.best is None:
            raise RuntimeError("Expected train() or load() before sample().")
        noise = self.rng.uniform(-0.1, 0.1, (n, self.dimension)) * (1 - np.abs(self.best))
        return (self.best + noise).astype(np.float32)

    def save(self, folder: Path) -> None:
        state = {"best": self.best.tolist(), "rng": self.rng.bit_generator.state}
        (folder / "adversary.json").write_text(json.dumps(state))

    @classmethod
    def load(cls, folder: Path) -> Self:
        state = json.loads((folder / "adversary.json").read_text())
        adversary = cls(len(state["best"]))
        adversary.best = np.array(state["best"], dtype=np.float32)
        adversary.rng.bit_generator.state = state["rng"]
        return adversary


class TestAroundTheBest(AdversaryContract):
    def make(self, dimension: int, seed: int) -> Adversary:
        return AroundTheBest(dimension, seed=seed)


class Replayer(AroundTheBest):
    """Gives its one best query away as a sample, again and again."""

    def sample(self, n: int) -> np.ndarray:
        return np.tile(self.best, (n, 1))


class Spendthrift(AroundTheBest):
    def train(self, oracle: Query) -> None:
        oracle(np.zeros((oracle.remaining + 1, self.dimension)))


class Meddler(AroundTheBest):
    def sample(self, n: int) -> np.ndarray:
        torch.rand(1)
        return super().sample(n)


class Forgetful(AroundTheBest):
    """Saves no generator state."""

    @classmethod
    def load(cls, folder: Path) -> Self:
        adversary = super().load(folder)
        adversary.rng = np.random.default_rng(0)
        return adversary


def contract_of(adversary: type[Adversary]) -> AdversaryContract:
    contract = AdversaryContract()
    contract.make = lambda dimension, seed: adversary(dimension, seed=seed)
    return contract


def trained(contract: AdversaryContract) -> Training:
    return Training(*contract.train(), np.zeros((0, contract.dimension), np.float32))


def test_stored_queries_are_caught() -> None:
    contract = contract_of(Replayer)
    with pytest.raises(AssertionError):
        contract.test_samples_are_fresh(trained(contract))


def test_overspending_is_caught() -> None:
    with pytest.raises(pytest.fail.Exception, match="201 queries were asked for, 200 were left"):
        contract_of(Spendthrift).train()


def test_global_randomness_is_caught() -> None:
    with pytest.raises(AssertionError):
        contract_of(Meddler).test_global_generators_are_left_alone()


def test_a_lost_generator_state_is_caught(tmp_path: Path) -> None:
    contract = contract_of(Forgetful)
    with pytest.raises(AssertionError):
        contract.test_saved_and_loaded_goes_on_the_same(trained(contract), tmp_path)


def test_recording_oracle_keeps_the_queries() -> None:
    oracle = RecordingOracle(AnalyticApplication(), budget=5)
    oracle(np.zeros((2, 2)))
    assert oracle.remaining == 3
    assert oracle.queries.shape == (2, 2)


class TestAnalyticKeepsTheContract(ApplicationContract):
    def make(self) -> Application:
        return AnalyticApplication(dimension=5, noise=0.1)


class Plain(Application):
    """Sound as it stands; subclasses below break it."""

    name = "Plain"
    fooling_threshold = 0.3
    sample_size = 10
    parameters = ParameterSpace(Parameter("a", 0, 1), Parameter("b", 0, 1))

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = np.abs(mu).mean(axis=1, dtype=np.float64)
        return Scored(score, [{} for _ in seeds])


class BatchDependent(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scored = super().evaluate_batch(mu, seeds)
        return Scored(scored.score * (1 - 1e-12 * (len(mu) == 17)), scored.extras)


class NeighbourDependent(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scored = super().evaluate_batch(mu, seeds)
        return Scored(scored.score / max(scored.score.max(), 0.5), scored.extras)


class Clocked(Plain):
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scored = super().evaluate_batch(mu, seeds)
        return Scored(scored.score, [{"took_s": time.perf_counter()} for _ in seeds])


class ProcessDependent(Plain):
    """Pickling loses half of it."""

    scale = 1.0

    def __init__(self) -> None:
        self.scale = 0.5

    def __getstate__(self) -> dict[str, Any]:
        return {}

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        scored = super().evaluate_batch(mu, seeds)
        return Scored(scored.score * self.scale, scored.extras)


def test_assert_pure_passes_a_pure_application() -> None:
    assert_pure(Plain())


@pytest.mark.parametrize(
    ("application", "message"),
    [
        (BatchDependent, r"Expected the same score .* in a batch of 17"),
        (NeighbourDependent, r"Expected the same score .* evaluated alone"),
        (Clocked, r"other values of \['took_s'\] for world 0 evaluated a second time"),
        (ProcessDependent, r"Expected the same score .* in another process"),
    ],
)
def test_assert_pure_catches(application: type[Application], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        assert_pure(application())


def test_assert_pure_says_what_cannot_be_pickled() -> None:
    application = Plain()
    application.callback = lambda: None  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="Expected Plain to be picklable"):
        assert_pure(application, sizes=[])
