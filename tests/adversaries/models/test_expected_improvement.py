import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from sada_gym.adversaries.models.expected_improvement import (
    ImprovementSearch,
    expected_improvement,
    lowest,
)


def test_expected_improvement_is_the_integral():
    mean, deviation = np.array([0.2, 1.0, -3.0, 5.0]), np.array([0.5, 1e-12, 2.0, 0.4])
    u = (0.4 - mean) / deviation
    formula = (0.4 - mean) * norm.cdf(u) + deviation * norm.pdf(u)
    assert_allclose(expected_improvement(mean, deviation, 0.4), formula, rtol=1e-12, atol=1e-300)
    integral, _ = quad(lambda v: (0.4 - v) * norm.pdf(v, 0.2, 0.5), -5, 0.4)
    assert_allclose(expected_improvement(mean, deviation, 0.4)[0], integral, rtol=1e-8)


def test_chooses_what_scikit_learn_expects_most_of_against_the_best_smoothed_point():
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1.0, 1.0, (60, 2)).astype(np.float32)
    score = np.minimum(((mu - 0.3) ** 2).mean(axis=1), 1.0) + 0.3 * rng.normal(size=60)
    engine = ImprovementSearch(mu, score, None, rng, candidates=512, capacity=70)
    chosen = engine.choose()

    kernel, scale = engine.kernel, score.std()
    regressor = GaussianProcessRegressor(
        ConstantKernel(kernel.signal) * Matern(kernel.length_scales, nu=2.5),
        alpha=kernel.noise,
        optimizer=None,
    ).fit(mu, (score - score.mean()) / scale)
    incumbent = regressor.predict(mu).min()
    assert incumbent > ((score - score.mean()) / scale).min() + 0.5
    new = ~(engine._posterior.pool[:, None] == mu).all(axis=2).any(axis=1)
    mean, deviation = regressor.predict(engine._posterior.pool[new], return_std=True)
    u = (incumbent - mean) / deviation
    improvement = (incumbent - mean) * norm.cdf(u) + deviation * norm.pdf(u)
    assert (engine._posterior.pool[new][np.argmax(improvement)] == chosen).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("dimension", [2, 8])
def test_every_step_chooses_as_a_search_that_computes_everything_afresh(seed, dimension):
    """The reference holds no factor: it solves in float64 at each step, for all candidates."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-1.0, 1.0, (40, dimension)).astype(np.float32)

    def score(points):
        return 0.3 * np.sin(4.0 * points).mean(axis=1) + 0.05 * rng.normal(size=len(points))

    scores = score(mu)
    offset, scale = scores.mean(), scores.std()
    engine = ImprovementSearch(mu, scores, None, rng, candidates=512, capacity=80)
    kernel = engine.kernel
    for _ in range(40):
        chosen = engine.choose()
        pool, values = engine._posterior.pool, (scores - offset) / scale
        noisy = kernel(mu, mu) + kernel.noise * np.eye(len(mu))
        across = kernel(mu, pool)
        mean = across.T @ np.linalg.solve(noisy, values)
        variance = kernel.signal - (across * np.linalg.solve(noisy, across)).sum(axis=0)
        evaluated = (pool[:, None] == mu).all(axis=2).any(axis=1)
        improvement = expected_improvement(mean, np.sqrt(variance), mean[evaluated].min())
        improvement[evaluated] = -1.0
        assert (pool[np.argmax(improvement)] == chosen).all()
        mu = np.concatenate([mu, chosen[None]])
        value = score(chosen[None])
        engine.observe(value)
        scores = np.append(scores, value)


@pytest.mark.parametrize("count", [1, 7, 200, 300])
def test_lowest_are_the_first_of_a_stable_sort(count):
    values = np.random.default_rng(0).integers(0, 9, 200).astype(float)
    values[:5] = -np.inf
    assert_array_equal(lowest(values, count), np.argsort(values, kind="stable")[:count])
