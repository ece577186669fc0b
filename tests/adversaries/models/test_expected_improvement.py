import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.models.expected_improvement import (
    _Search,
    expected_improvement,
    minimise,
    stages,
)
from sada_gym.adversaries.omega import evaluate_uniform
from sada_gym.testing.landscapes import FunctionOracle

QUICK = {"candidates": 512}


def bowl(mu):
    return np.minimum(((mu - 0.3) ** 2).mean(axis=1), 1.0)


def search(score, budget, *, dimension=2, initial=10, seed=0, **options):
    oracle, rng = FunctionOracle(score, budget), np.random.default_rng(seed)
    omega = evaluate_uniform(initial, dimension, oracle, rng)
    return minimise(oracle, omega, rng, **{**QUICK, **options}), oracle


def test_expected_improvement_is_the_integral():
    mean, deviation = np.array([0.2, 1.0, -3.0, 5.0]), np.array([0.5, 1e-12, 2.0, 0.4])
    u = (0.4 - mean) / deviation
    formula = (0.4 - mean) * norm.cdf(u) + deviation * norm.pdf(u)
    assert_allclose(expected_improvement(mean, deviation, 0.4), formula, rtol=1e-12, atol=1e-300)
    integral, _ = quad(lambda v: (0.4 - v) * norm.pdf(v, 0.2, 0.5), -5, 0.4)
    assert_allclose(expected_improvement(mean, deviation, 0.4)[0], integral, rtol=1e-8)


def test_chooses_what_scikit_learn_expects_most_of_against_the_best_smoothed_point():
    rng = np.random.default_rng(0)
    oracle = FunctionOracle(lambda mu: bowl(mu) + 0.3 * rng.normal(size=len(mu)), 60)
    omega = evaluate_uniform(60, 2, oracle, rng)
    engine = _Search(omega, None, rng, candidates=512, capacity=70)
    chosen = engine.choose()

    kernel, scale = engine.kernel, omega.score.std()
    regressor = GaussianProcessRegressor(
        ConstantKernel(kernel.signal) * Matern(kernel.length_scales, nu=2.5),
        alpha=kernel.noise,
        optimizer=None,
    ).fit(omega.mu, (omega.score - omega.score.mean()) / scale)
    incumbent = regressor.predict(omega.mu).min()
    assert incumbent > ((omega.score - omega.score.mean()) / scale).min() + 0.5
    new = ~(engine._posterior.pool[:, None] == omega.mu).all(axis=2).any(axis=1)
    mean, deviation = regressor.predict(engine._posterior.pool[new], return_std=True)
    u = (incumbent - mean) / deviation
    improvement = (incumbent - mean) * norm.cdf(u) + deviation * norm.pdf(u)
    assert (engine._posterior.pool[new][np.argmax(improvement)] == chosen).all()


def test_finds_the_minimum_and_spends_all():
    omega, oracle = search(bowl, 60)
    assert oracle.remaining == 0
    assert_array_equal(omega.mu, np.concatenate(oracle.queries))
    assert omega.score.min() < 5e-4
    assert omega.score[10:].mean() < 0.2 * omega.score[:10].mean()


@pytest.mark.parametrize("dimension", [1, 2, 64])
def test_never_asks_twice_and_stays_in_the_box(dimension):
    omega, _ = search(bowl, 300 if dimension == 1 else 100, dimension=dimension)
    assert len(np.unique(omega.mu, axis=0)) == len(omega)
    assert (np.abs(omega.mu) <= 1).all()


def test_more_steps_than_candidates():
    omega, _ = search(lambda mu: np.abs(mu[:, 0]), 700, dimension=1)
    assert len(np.unique(omega.mu)) == 700


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_constant_scores(value):
    omega, _ = search(lambda mu: np.full(len(mu), value), 50)
    assert omega.mu.std(axis=0).min() > 0.3


def test_noise_does_not_hold_it_at_a_lucky_point():
    rng = np.random.default_rng(5)
    omega, _ = search(lambda mu: bowl(mu) + 0.2 * rng.normal(size=len(mu)), 150)
    assert np.sqrt(bowl(omega.mu[100:]).mean()) < 0.35


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_batches(batch):
    omega, oracle = search(bowl, 60, batch=batch)
    sizes = [len(query) for query in oracle.queries[1:]]
    assert max(sizes) == min(batch, 30)
    assert len(np.unique(omega.mu, axis=0)) == 60
    assert omega.score.min() < 2e-3


def test_a_batch_spreads():
    _, oracle = search(bowl, 40, batch=8, initial=20)
    apart = np.linalg.norm(oracle.queries[1][:, None] - oracle.queries[1], axis=2)
    assert apart[np.triu_indices(8, 1)].min() > 0.01


def test_does_not_depend_on_the_number_of_blas_threads():
    found = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            found.append(search(bowl, 80, dimension=8)[0].mu)
    assert_array_equal(*found)


def test_threads_are_as_before_while_the_oracle_works():
    from threadpoolctl import threadpool_info

    seen = set()

    def score(mu):
        seen.update(pool["num_threads"] for pool in threadpool_info())
        return bowl(mu)

    with threadpool_limits(2):
        search(score, 14)
    assert seen == {2}


def test_a_score_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="1 NaN"):
        search(lambda mu: np.where(len(mu) > 1, bowl(mu), np.nan), 20)


@pytest.mark.parametrize("start", [1, 7, 80])
@pytest.mark.parametrize("stop", [1, 80, 81, 1000, 10_000])
def test_stages_double_up_to_the_end_and_their_factorisations_stay_cheap(start, stop):
    ends = stages(start, stop)
    if stop <= start:
        assert ends == []
    else:
        assert ends[-1] == stop
        assert all(a // 2 == b for a, b in zip(ends[:0:-1], ends[-2::-1], strict=True))
        assert all(end > start for end in ends)
        assert sum(end**2 for end in ends[:-1]) <= stop**2 / 3
