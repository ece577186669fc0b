import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, WhiteKernel
from sklearn.gaussian_process.kernels import Matern as Reference

from sada_gym.adversaries.models.pool_posterior import (
    MIN_NOISE,
    Matern,
    PoolPosterior,
    _loss,
    fit_matern,
)

KERNEL = Matern(np.array([0.6, 1.5, 4.0]), 2.0, 0.02)
CAPACITY = 320


def problem(n):
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
    return x, np.sin(4 * x[:, 0]) + x[:, 1] + 0.1 * rng.normal(size=n)


def posterior_of(x, y, pool, dtype=np.float64):
    return PoolPosterior(KERNEL, pool, x, y, capacity=CAPACITY, dtype=dtype)


def grown(start, x, y, pool, dtype=np.float64):
    """Begin with `start` observations and take in the rest one by one, out of the pool."""
    posterior = posterior_of(x[:start], y[:start], np.concatenate([x[start:], pool]), dtype)
    for i in range(start, len(x)):
        posterior.condition(i - start)
        posterior.observe(y[i : i + 1])
    return posterior


def reference(x, y, points):
    kernel = ConstantKernel(KERNEL.signal) * Reference(KERNEL.length_scales, nu=2.5)
    regressor = GaussianProcessRegressor(kernel, alpha=KERNEL.noise, optimizer=None)
    return regressor.fit(x, y).predict(points, return_std=True)


POOL = np.random.default_rng(1).uniform(-1, 1, (200, 3)).astype(np.float32)


@pytest.mark.parametrize(("start", "n"), [(1, 40), (300, 300), (270, 310)])
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 1e-4)])
def test_mean_and_deviation_are_those_of_scikit_learn(start, n, dtype, tolerance):
    x, y = problem(n)
    posterior = grown(start, x, y, POOL, dtype)
    mean, deviation = reference(x, y, posterior.pool)
    assert_allclose(posterior.mean, mean, rtol=0, atol=tolerance)
    assert_allclose(np.sqrt(posterior.variance), deviation, rtol=0, atol=tolerance)
    smooth, _ = reference(x, y, x)
    assert_allclose(posterior.mean_at_observations(), smooth, rtol=0, atol=tolerance)


def test_incremental_equals_from_scratch():
    x, y = problem(300)
    late = grown(5, x, y, POOL)
    fresh = posterior_of(x, y, late.pool)
    assert_allclose(late.mean, fresh.mean, rtol=0, atol=1e-11)
    assert_allclose(late.variance, fresh.variance, rtol=0, atol=1e-11)


def test_without_values_variances_shrink_and_means_stay():
    x, y = problem(30)
    posterior = posterior_of(x[:20], y[:20], np.concatenate([x[20:], POOL]))
    mean = posterior.mean.copy()
    for index in range(10):
        posterior.condition(index)
    assert_allclose(posterior.mean, mean, rtol=0, atol=0)
    expected, deviation = reference(x, y, posterior.pool)
    assert_allclose(np.sqrt(posterior.variance), deviation, rtol=0, atol=1e-9)
    posterior.observe(y[20:])
    assert_allclose(posterior.mean, expected, rtol=0, atol=1e-9)


def test_new_candidates_are_exact_and_go_on():
    x, y = problem(300)
    posterior = grown(290, x[:299], y[:299], POOL)
    slots = np.array([3, 0, 100])
    posterior.replace(slots, np.concatenate([x[299:], POOL[:2] * 0.5]))
    assert_allclose(posterior.pool[[3, 100]], [x[299], POOL[1] * 0.5])
    posterior.condition(3)
    posterior.observe(y[299:])
    mean, deviation = reference(x, y, posterior.pool)
    assert_allclose(posterior.mean, mean, rtol=0, atol=1e-9)
    assert_allclose(np.sqrt(posterior.variance), deviation, rtol=0, atol=1e-9)


def test_float32_holds_where_the_noise_is_least_and_points_crowd():
    rng = np.random.default_rng(2)
    x = (0.05 * rng.normal(size=(1000, 3))).astype(np.float32)
    y = np.sin(9 * x[:, 0]) + 0.03 * rng.normal(size=1000)
    kernel = Matern(KERNEL.length_scales, 1.0, MIN_NOISE)
    single, double = (
        PoolPosterior(kernel, POOL, x, y, capacity=1000, dtype=dtype)
        for dtype in (np.float32, np.float64)
    )
    assert_allclose(np.sqrt(single.variance), np.sqrt(double.variance), rtol=0.03)
    assert (np.abs(single.mean - double.mean) < 0.1 * np.sqrt(double.variance)).all()


def test_loss_is_the_likelihood_and_the_prior_and_its_gradient_fits():
    x, y = problem(50)
    x = x.astype(np.float64)
    theta = np.log([0.6, 1.5, 4.0, 2.0, 0.01])
    kernel = ConstantKernel(2.0) * Reference([0.6, 1.5, 4.0], nu=2.5) + WhiteKernel(0.02)
    likelihood = GaussianProcessRegressor(kernel, optimizer=None).fit(x, y)
    constant = 25 * np.log(2 * np.pi)
    prior = ((theta[:3] - 0.3) ** 2).sum() / 6
    loss, gradient = _loss(theta, x, y, 0.3)
    expected = prior - likelihood.log_marginal_likelihood_value_ - constant
    assert_allclose(loss, expected, rtol=1e-6)
    numeric = approx_fprime(theta, lambda t: _loss(t, x, y, 0.3)[0])
    assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-4)


def test_fit_tells_live_dimensions_from_dead_ones_and_signal_from_noise():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1, 1, (300, 3))
    y = np.sin(5 * x[:, 0]) + 0.3 * rng.normal(size=300)
    scale = y.std()
    kernel = fit_matern(x, y / scale)
    assert kernel.length_scales[0] < 1.5
    assert kernel.length_scales[1:].min() > 5
    assert_allclose(kernel.noise * scale**2, 0.09, rtol=0.25)
    again = fit_matern(x, y / scale, kernel)
    assert_allclose(np.log(again.length_scales[0]), np.log(kernel.length_scales[0]), atol=0.05)


@pytest.mark.parametrize("n", [1, 2, 40])
def test_fit_survives_constant_values(n):
    x, _ = problem(n)
    kernel = fit_matern(x, np.zeros(n))
    assert np.isfinite(kernel.length_scales).all()
    assert kernel.noise >= MIN_NOISE * kernel.signal * (1 - 1e-9)
