import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.models.exact_gp import fit_weights, predict_mean
from sada_gym.adversaries.models.surrogate import (
    CrossFittedTrees,
    RandomisedTrees,
    SparseGP,
    Surrogate,
)
from studies.landscapes import Landscape


@pytest.fixture(autouse=True)
def one_thread():
    """As in `Surrogate`: threads that wait for each other take far longer than one."""
    with threadpool_limits(1):
        yield


def noisy(n, d, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, d))
    return x, np.sin(3 * x[:, 0]) + 0.2 * rng.normal(size=n)


def test_with_all_points_as_regressors_the_process_is_exact():
    x, y = noisy(120, 2)
    sparse = SparseGP(x, y, np.random.default_rng(0), regressors=120, subset=120)
    z = (y - y.mean()) / y.std()
    at = np.random.default_rng(1).uniform(-1, 1, (50, 2))
    exact = predict_mean(sparse._kernel, x, fit_weights(sparse._kernel, x, z), at)
    assert sparse(at) == pytest.approx(y.mean() + y.std() * exact, abs=1e-4)


def test_held_out_means_are_those_of_a_fit_without_the_point():
    x, y = noisy(60, 2)
    sparse = SparseGP(x, y, np.random.default_rng(0), regressors=60, subset=60)
    kernel, scale = sparse._kernel, y.std()
    z = (y - y.mean()) / scale
    for i in (0, 17, 59):
        rest = np.arange(60) != i
        weights = fit_weights(kernel, x[rest], z[rest])
        left_out = y.mean() + scale * predict_mean(kernel, x[rest], weights, x[i : i + 1])[0]
        assert sparse.held_out[i] == pytest.approx(left_out, abs=1e-3)


@pytest.mark.parametrize("model", [SparseGP, CrossFittedTrees, RandomisedTrees])
def test_held_out_predictions_are_no_better_than_they_are_on_new_points(model):
    x, y = noisy(400, 3)
    fitted = model(x, y, np.random.default_rng(0))
    fresh, values = noisy(400, 3, seed=1)
    held_out = np.mean((fitted.held_out - y) ** 2)
    assert np.mean((fitted(x) - y) ** 2) < 0.9 * held_out  # it has seen these
    assert held_out == pytest.approx(np.mean((fitted(fresh) - values) ** 2), rel=0.25)


def test_constant_values_are_predicted_as_they_are():
    x, _ = noisy(50, 2)
    for model in (SparseGP, CrossFittedTrees, RandomisedTrees):
        assert model(x, np.full(50, 0.7), np.random.default_rng(0))(x) == pytest.approx(0.7)


def test_probabilities_are_calibrated_on_new_points():
    waves = Landscape(0)
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (2_000, 8)).astype(np.float32)
    surrogate = Surrogate(mu, waves(mu), 0.3, rng)
    fresh = rng.uniform(-1, 1, (6_000, 8)).astype(np.float32)
    p, true = surrogate(fresh), waves.fooling_rate(fresh)
    assert p.min() >= 0.0
    assert p.max() <= 1.0
    for low, high in ((0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0)):
        within = (p >= low) & (p < high)
        assert within.sum() > 50
        assert abs(p[within].mean() - true[within].mean()) < 0.12
    assert true[p >= 0.5].mean() > 1.8 * true.mean()


def test_where_few_fool_it_leads_to_the_lowest_scores():
    x, _ = noisy(400, 2)
    score = 0.4 + 0.25 * (x[:, 0] + 1.0)
    surrogate = Surrogate(x.astype(np.float32), score, 0.3, np.random.default_rng(0))
    p = surrogate(np.array([[-0.99, 0.0], [0.0, 0.0]]))
    assert p[0] > 0.5
    assert p[1] < 0.1


@pytest.mark.parametrize("count", [40, 100])
def test_few_points_are_split_and_lead_to_a_corner(count):
    rng = np.random.default_rng(count)
    mu = rng.uniform(-1, 1, (count, 4)).astype(np.float32)

    def score(points):
        return np.clip(0.6 - 0.5 * np.minimum(points[:, 0], points[:, 1]), 0.0, 1.0)

    surrogate = Surrogate(mu, score(mu), 0.5, rng)
    assert surrogate.raised == ((score(mu) <= 0.5).sum() < max(5, count // 10))
    fresh = rng.uniform(-1, 1, (4_000, 4)).astype(np.float32)
    p, fooled = surrogate(fresh), score(fresh) <= 0.5
    assert fooled[np.argsort(-p)[:400]].mean() > 2.5 * fooled.mean()


def test_the_sparse_process_agrees_with_scikit_learn():
    x, y = noisy(80, 2)
    sparse = SparseGP(x, y, np.random.default_rng(0), regressors=80, subset=80)
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    kernel = ConstantKernel(sparse._kernel.signal) * Matern(sparse._kernel.length_scales, nu=0.5)
    z = (y - y.mean()) / y.std()
    theirs = GaussianProcessRegressor(kernel, alpha=sparse._kernel.noise, optimizer=None).fit(x, z)
    at = np.random.default_rng(1).uniform(-1, 1, (30, 2))
    assert sparse(at) == pytest.approx(y.mean() + y.std() * theirs.predict(at), abs=1e-4)
