import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from sada_gym.adversaries import gp
from sada_gym.adversaries.gp import CONSTANT, GP
from sada_gym.adversaries.models import exact_gp
from sada_gym.adversaries.models.exact_gp import (
    Kernel,
    fit_kernel,
    fit_weights,
    log_marginal_likelihood,
    predict_mean,
)
from sada_gym.adversaries.selection import NONE_FOOLED_BUT_ALL_LEARNT
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape


class TestGP(AdversaryContract):
    def make(self, dimension, seed):
        return GP(dimension, seed=seed, subset=50)


def case(dimension, n=120):
    rng = np.random.default_rng(dimension)
    x, at = rng.uniform(-1.0, 1.0, (n, dimension)), rng.uniform(-1.0, 1.0, (50, dimension))
    kernel = Kernel(rng.uniform(0.3, 3.0, dimension), 1.7, 0.05)
    return kernel, x, rng.normal(size=n), at


def reference(kernel, x, y):
    covariance = ConstantKernel(kernel.signal) * Matern(kernel.length_scales, nu=0.5)
    covariance += WhiteKernel(kernel.noise)
    return GaussianProcessRegressor(covariance, alpha=0.0, optimizer=None).fit(x, y)


@pytest.mark.parametrize("dimension", [1, 3, 8])
def test_mean_equals_that_of_scikit_learn(dimension, monkeypatch):
    monkeypatch.setattr(exact_gp, "_BLOCK", 7)
    kernel, x, y, at = case(dimension)
    mean = predict_mean(kernel, x, fit_weights(kernel, x, y), at)
    assert_allclose(mean, reference(kernel, x, y).predict(at), atol=1e-8)


@pytest.mark.parametrize("dimension", [1, 3, 8])
def test_marginal_likelihood_and_gradient_equal_those_of_scikit_learn(dimension):
    kernel, x, y, _ = case(dimension)
    model = reference(kernel, x, y)
    theirs, slope = model.log_marginal_likelihood(model.kernel_.theta, eval_gradient=True)
    value, gradient = log_marginal_likelihood(kernel, x, y)
    assert_allclose(value, theirs, atol=1e-8)
    signal, *length_scales, noise = slope
    assert_allclose(gradient, [*length_scales, signal, noise], rtol=1e-8, atol=1e-8)


def test_the_gradient_copes_with_points_that_coincide():
    kernel, x, y, _ = case(2)
    value, gradient = log_marginal_likelihood(kernel, np.repeat(x, 2, axis=0), np.repeat(y, 2))
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()


def test_hyper_parameters_tell_the_dimension_that_matters():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, (300, 2))
    y = np.sin(4.0 * x[:, 0]) + 0.5 * rng.normal(size=300)
    y = (y - y.mean()) / y.std()
    kernel = fit_kernel(x, y)
    assert kernel.length_scales[1] > 10 * kernel.length_scales[0]
    assert 0.1 < kernel.noise < 0.5
    start = log_marginal_likelihood(Kernel(np.full(2, 2.0), 1.0, 0.1), x, y)[0]
    assert log_marginal_likelihood(kernel, x, y)[0] > start


def by_gradients(monkeypatch, inducing=200):
    monkeypatch.setattr(exact_gp, "_MAX_FACTORISED", 0)
    monkeypatch.setattr(exact_gp, "_INDUCING", inducing)


@pytest.mark.parametrize("dimension", [1, 3, 8])
@pytest.mark.parametrize("noise", [1e-3, 0.05, 10.0])
@pytest.mark.parametrize("copies", [1, 2])
def test_conjugate_gradients_give_the_factorisations_mean(dimension, noise, copies, monkeypatch):
    kernel, x, y, at = case(dimension, n=600)
    kernel = Kernel(kernel.length_scales, kernel.signal, noise)
    x, y = np.repeat(x, copies, axis=0), np.repeat(y, copies)
    expected = predict_mean(kernel, x, fit_weights(kernel, x, y), at)
    by_gradients(monkeypatch)
    monkeypatch.setattr(exact_gp, "_factorise", None)  # it must not be needed
    assert_allclose(predict_mean(kernel, x, fit_weights(kernel, x, y), at), expected, atol=1e-8)


def test_what_too_few_steps_do_not_solve_is_factorised(monkeypatch):
    kernel, x, y, _ = case(3, n=300)
    expected = fit_weights(kernel, x, y)
    by_gradients(monkeypatch)
    monkeypatch.setattr(exact_gp, "_MAX_STEPS", 1)
    assert (fit_weights(kernel, x, y) == expected).all()


@pytest.mark.parametrize("dimension", [2, 8])
def test_conjugate_gradients_choose_the_same_samples(dimension, monkeypatch):
    def samples(seed):
        adversary = GP(dimension, seed=seed, subset=100)
        adversary.train(FunctionOracle(lambda mu: np.abs(mu).max(axis=1), 500))
        return adversary.sample(100)

    factorised = [samples(seed) for seed in range(3)]
    by_gradients(monkeypatch)
    assert_array_equal([samples(seed) for seed in range(3)], factorised)


@pytest.mark.parametrize("gradients", [False, True])
def test_no_solver_copies_the_matrix(gradients, monkeypatch):
    """LAPACK and BLAS would silently copy an array in the other order."""
    kernel, x, y, _ = case(2, n=3000)
    if gradients:
        by_gradients(monkeypatch, inducing=100)
    tracemalloc.start()
    fit_weights(kernel, x, y)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.5 * 8 * 3000**2


def trained(score, budget=100, dimension=2):
    adversary = GP(dimension, seed=0)
    adversary.train(FunctionOracle(score, budget))
    return adversary


def test_predicts_the_score_itself():
    """Standardising the scores is undone."""
    adversary = trained(lambda mu: 0.6 + 0.1 * mu[:, 0], budget=400)
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (100, 2))
    assert_allclose(adversary._predict(points), 0.6 + 0.1 * points[:, 0], atol=0.01)
    assert adversary.flags == [NONE_FOOLED_BUT_ALL_LEARNT]
    assert (adversary.sample(10)[:, 0] < -0.9).all()


@pytest.mark.parametrize("score", [0.0, 0.1, 0.7, 1.0])
def test_constant_scores_give_uniform_samples(score):
    adversary = trained(lambda mu: np.full(len(mu), score), budget=300)
    assert adversary.flags[-1] == CONSTANT
    assert abs(adversary.sample(1000).std() - 3**-0.5) < 0.03


@pytest.mark.parametrize("dimension", [1, 64])
@pytest.mark.parametrize("budget", [2, 60])
def test_few_or_many_dimensions(dimension, budget):
    adversary = trained(lambda mu: np.abs(mu).max(axis=1), budget, dimension)
    assert adversary.sample(20).shape == (20, dimension)


def test_more_points_than_memory_allows_are_left_out_and_flagged(monkeypatch, tmp_path):
    monkeypatch.setattr(gp, "MAX_POINTS", 50)
    adversary = trained(lambda mu: np.abs(mu[:, 0]), budget=80)
    assert adversary.flags == ["fitted to the first 50 points of Omega's 80"]
    adversary.save(tmp_path)
    assert (GP.load(tmp_path).sample(50) == adversary.sample(50)).all()


@pytest.mark.parametrize("dimension", [2, 5])
def test_beats_uniform_on_four_regions(dimension):
    application = AnalyticApplication(dimension=dimension)
    adversary = GP(dimension, seed=0, subset=300)
    adversary.train(RecordingOracle(application, budget=1000))
    region = application.fooling_region(adversary.sample(250))
    assert (region >= 0).mean() > 0.3
    assert set(region) == {-1, 0, 1, 2, 3}


def test_beats_uniform_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = GP(8, seed=0, subset=300)
    adversary.train(FunctionOracle(landscape, 1000))
    assert landscape.fooling_rate(adversary.sample(250)).mean() > 0.35 + 0.3


def test_nan_is_refused():
    with pytest.raises(ValueError, match="Expected 100 finite scores"):
        trained(lambda mu: np.full(len(mu), np.nan))
