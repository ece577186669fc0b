"""Contracts as test classes: subclass one, and pytest checks your adversary or application."""

# ruff: noqa: D102 - a test's name says what it tests

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from numpy.testing import assert_array_equal

from sada_gym.adversaries.base import Adversary
from sada_gym.adversaries.fresh import row_keys
from sada_gym.application import Application
from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import fools
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import FoolingRate, attack_fooling_rate
from sada_gym.parameters import Permits, validate_mu
from sada_gym.testing import rules
from sada_gym.testing.processes import in_fresh_process
from sada_gym.testing.purity import assert_pure, assert_same_in_another_process, draw_worlds
from sada_gym.testing.scales import scales

_SAFE_SUFFIXES = {".safetensors", ".json", ".npz", ".toml"}


class RecordingOracle:
    """The smallest oracle; it fails the test if an adversary asks for more than its budget.

    Args:
        application: The application that gives Q; each query's seed is its index.
        budget: The number of queries.

    Attributes:
        queries: All mu queried so far, (n, d) float32.
    """

    def __init__(self, application: Application, *, budget: int) -> None:
        self._application = application
        self._budget = budget
        self.queries = np.zeros((0, len(application.parameters)), dtype=np.float32)

    @property
    def remaining(self) -> int:
        """The number of queries left."""
        return self._budget - len(self.queries)

    @property
    def threshold(self) -> float:
        """The fooling threshold."""
        return self._application.fooling_threshold

    @property
    def permits(self) -> Permits:
        """Says which worlds can exist."""
        return self._application.permits

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the scores, (n,) float64, of mu (n, d)."""
        batch = validate_mu(mu, self.queries.shape[1])
        if len(batch) > self.remaining:
            pytest.fail(f"{len(batch)} queries were asked for, {self.remaining} were left")
        seeds = range(len(self.queries), len(self.queries) + len(batch))
        self.queries = np.concatenate([self.queries, batch])
        return self._application.evaluate(batch, seeds).score


class Training(NamedTuple):
    """A trained adversary, the oracle it was trained on, and what it sampled first, (100, d)."""

    adversary: Adversary
    oracle: RecordingOracle
    first_samples: npt.NDArray[np.float32]


class AdversaryContract:
    """Tests the rules that every adversary keeps. Subclass it and implement `make`.

    Attributes:
        dimension: d in the tests that need only one.
        budget: The number of queries of a training that takes about a second.
        continuous: Whether fresh samples never repeat: False for an adversary that draws from a
            finite set.
        uses_values: Whether the adversary's definition works with the values of Q, so that it
            learns something else when Q is scaled differently. All others must learn the same.
    """

    dimension: int = 2
    budget: int = 200
    continuous: bool = True
    uses_values: bool = False

    def make(self, dimension: int, seed: int) -> Adversary:
        """Make the adversary with options that let it train fast."""
        raise NotImplementedError("Implement make(dimension, seed) in the subclass.")

    def train(
        self, *, dimension: int | None = None, seed: int = 0, budget: int | None = None
    ) -> tuple[Adversary, RecordingOracle]:
        """Make and train an adversary on the analytic application."""
        dimension = dimension or self.dimension
        application = AnalyticApplication(dimension=dimension)
        oracle = RecordingOracle(application, budget=budget or self.budget)
        adversary = self.make(dimension, seed)
        adversary.train(oracle)
        return adversary, oracle

    @pytest.fixture(scope="class")
    @classmethod
    def training(cls) -> Training:
        """Train once for all tests of the class, which only draw samples."""
        adversary, oracle = cls().train()
        return Training(adversary, oracle, adversary.sample(100))

    @pytest.mark.parametrize("dimension", [1, 2, 16])
    def test_samples_lie_in_the_box(self, dimension: int) -> None:
        adversary, _ = self.train(dimension=dimension)
        for n in (0, 1, 100):
            samples = adversary.sample(n)
            assert samples.shape == (n, dimension)
            assert samples.dtype == np.float32
            assert (np.abs(samples) <= 1.0).all()

    def test_samples_are_fresh(self, training: Training) -> None:
        if not self.continuous:
            pytest.skip("draws from a finite set")
        samples = training.adversary.sample(10_000)
        assert len(np.unique(samples, axis=0)) == len(samples)
        assert not row_keys(samples) & row_keys(training.oracle.queries)

    def test_a_second_draw_goes_on(self, training: Training) -> None:
        assert (training.adversary.sample(100) != training.adversary.sample(100)).any()

    def test_same_seed_same_result(self, training: Training) -> None:
        again, oracle_again = self.train()
        assert_array_equal(oracle_again.queries, training.oracle.queries)
        assert_array_equal(again.sample(100), training.first_samples)

    def test_asked_and_told_it_learns_the_same(self, training: Training) -> None:
        oracle = RecordingOracle(AnalyticApplication(dimension=self.dimension), budget=self.budget)
        adversary = self.make(self.dimension, 0)
        adversary.start(self.budget, threshold=oracle.threshold)
        while len(mu := adversary.ask(7)):
            adversary.tell(mu, oracle(mu))
        assert_array_equal(oracle.queries, training.oracle.queries)
        assert_array_equal(adversary.sample(100), training.first_samples)

    def test_other_seed_other_result(self, training: Training) -> None:
        other, _ = self.train(seed=1)
        assert (other.sample(100) != training.first_samples).any()

    def test_same_result_in_another_process(self, training: Training) -> None:
        samples = in_fresh_process(self._first_samples, home=type(self))
        assert_array_equal(samples, training.first_samples)

    def _first_samples(self) -> npt.NDArray[np.float32]:
        adversary, _ = self.train()
        return adversary.sample(100)

    def test_a_small_budget_suffices_or_is_refused(self) -> None:
        for budget in (1, 3, 10):
            try:
                adversary, oracle = self.train(budget=budget)
            except ValueError as error:
                assert "budget" in str(error)  # noqa: PT017 - refusing is allowed, not required
            else:
                assert oracle.remaining >= 0
                assert adversary.sample(10).shape == (10, self.dimension)

    def test_saved_and_loaded_goes_on_the_same(self, training: Training, tmp_path: Path) -> None:
        adversary = training.adversary
        adversary.sample(7)
        adversary.save(tmp_path)
        loaded = type(adversary).load(tmp_path)
        assert loaded.dimension == self.dimension
        assert_array_equal(loaded.sample(100), adversary.sample(100))

    def test_saved_files_hold_no_pickles(self, training: Training, tmp_path: Path) -> None:
        training.adversary.save(tmp_path)
        files = [path for path in tmp_path.rglob("*") if path.is_file()]
        assert files
        for path in files:
            assert path.suffix in _SAFE_SUFFIXES
            if path.suffix == ".npz":
                with np.load(path, allow_pickle=False) as arrays:
                    assert all(arrays[key].dtype != object for key in arrays)

    def test_what_it_learns_does_not_depend_on_the_scale_of_q(self) -> None:
        if self.uses_values:
            pytest.skip("its definition works with the values of Q")
        boxes = AnalyticApplication(dimension=self.dimension)
        truth = boxes.sample_fooling_set(1_000, np.random.default_rng(0))

        def score(mu: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
            return boxes.evaluate(mu, range(len(mu))).score

        results: list[tuple[str, FoolingRate, float]] = []
        uniform = np.random.default_rng(1).uniform(-1.0, 1.0, (5_000, self.dimension))
        for scale in scales(score(uniform.astype(np.float32))):
            threshold = float(scale.map(boxes.fooling_threshold))
            oracle = Oracle(
                lambda mu, scale=scale: scale.map(score(mu)),
                dimension=self.dimension,
                threshold=threshold,
                budget=self.budget,
            )
            adversary = self.make(self.dimension, 0)
            adversary.train(oracle)
            mu = adversary.sample(250)
            afr = attack_fooling_rate(score(mu), boxes.fooling_threshold)
            fooled = fools(score(mu), boxes.fooling_threshold)
            results.append((scale.name, afr, fooling_coverage(mu, fooled, truth).coverage))
        _, rates, coverages = zip(*results, strict=True)
        assert max(rate.low for rate in rates) <= min(rate.high for rate in rates), results
        assert max(coverages) - min(coverages) <= 0.1, results

    def test_sampling_before_training_is_refused(self) -> None:
        with pytest.raises(RuntimeError, match="train"):
            self.make(self.dimension, 0).sample(1)

    def test_a_dimension_below_one_is_refused(self) -> None:
        with pytest.raises(ValueError, match="dimension"):
            self.make(0, 0)

    def test_global_generators_are_left_alone(self) -> None:
        import torch  # noqa: F401 - its generator is watched only once it is loaded

        before = rules.global_states()
        adversary, _ = self.train()
        adversary.sample(10)
        assert rules.global_states() == before


class ApplicationContract:
    """Tests the rules that every application keeps. Subclass it and implement `make`.

    Attributes:
        sizes: The batch sizes of the tests of purity, out of 1 to 70; None takes all.
    """

    sizes: tuple[int, ...] | None = None

    def make(self) -> Application:
        """Make the application."""
        raise NotImplementedError("Implement make() in the subclass.")

    @pytest.fixture(scope="class")
    @classmethod
    def application(cls) -> Iterator[Application]:
        """Make one application for all tests of the class."""
        application = cls().make()
        yield application
        application.close()

    def test_declaration(self, application: Application) -> None:
        rules.check_declaration(application)

    def test_scores_and_infos(self, application: Application) -> None:
        rules.check_outcomes(application)

    def test_randomness_comes_from_the_seeds(self, application: Application) -> None:
        rules.check_randomness(application)

    def test_two_instances_agree(self, application: Application) -> None:
        mu, seeds = draw_worlds(application, 8, seed=4)
        other = self.make()
        assert_array_equal(
            other.evaluate(mu, seeds).score, application.evaluate(mu, seeds).score, strict=True
        )
        other.close()

    def test_no_parameter_is_dead(self, application: Application) -> None:
        rules.check_live_parameters(application)

    def test_pure(self, application: Application) -> None:
        assert_pure(application, sizes=self.sizes, other_process=False)

    def test_same_in_another_process(self, application: Application) -> None:
        assert_same_in_another_process(application)

    def test_pictures(self, application: Application) -> None:
        rules.check_pictures(application)

    def test_environment(self, application: Application) -> None:
        rules.check_environment_steps(AdversaryEnv(application))

    def test_an_empty_batch_gives_no_outcomes(self, application: Application) -> None:
        outcomes = application.evaluate(np.zeros((0, len(application.parameters))), [])
        assert outcomes.score.shape == outcomes.fooled.shape == (0,)
        assert outcomes.infos == ()

    def test_mu_is_rounded_to_float32_once(self, application: Application) -> None:
        mu = np.random.default_rng(5).uniform(-1.0, 1.0, (4, len(application.parameters)))
        assert_array_equal(
            application.evaluate(mu, range(4)).score,
            application.evaluate(mu.astype(np.float32), range(4)).score,
        )

    @pytest.mark.parametrize(
        ("mu", "message"),
        [
            (np.nan, r"Expected mu within \[-1, 1\], got nan"),
            (1.001, r"Expected mu within \[-1, 1\], got 1.001"),
            (-np.inf, r"Expected mu within \[-1, 1\], got -inf"),
        ],
    )
    def test_bad_mu_is_refused(self, application: Application, mu: float, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            application.evaluate(np.full((1, len(application.parameters)), mu), [0])

    def test_a_wrong_shape_is_refused(self, application: Application) -> None:
        d = len(application.parameters)
        with pytest.raises(ValueError, match=rf"Expected mu of shape \(n, {d}\), got \(1, {d + 1}"):
            application.evaluate(np.zeros((1, d + 1)), [0])

    @pytest.mark.parametrize("seed", [-1, 2**31, 0.5, True, None, "7"])
    def test_a_bad_seed_is_refused(self, application: Application, seed: Any) -> None:
        with pytest.raises(ValueError, match=r"Expected seeds to be ints in \[0, 2\*\*31\), got"):
            application.evaluate(np.zeros((1, len(application.parameters))), [seed])
