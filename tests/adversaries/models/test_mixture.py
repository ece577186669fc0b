import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import kstest, multivariate_normal, truncnorm
from sklearn.mixture import GaussianMixture

from sada_gym.adversaries.models.mixture import Mixture, fit_best_mixture, fit_mixture, reflect
from sada_gym.envs.analytic import AnalyticApplication


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def single(mean, covariance):
    factor = np.linalg.cholesky(np.atleast_2d(covariance))
    return Mixture(np.ones(1), np.atleast_2d(mean).astype(float), factor[None])


def covariances(mixture):
    return mixture.factors @ mixture.factors.transpose(0, 2, 1)


def test_em_finds_two_gaussians(rng):
    covariance = np.array([[0.02, 0.01], [0.01, 0.02]])
    left = rng.multivariate_normal([-0.5, 0.0], covariance, 3000)
    right = rng.multivariate_normal([0.5, 0.2], 0.01 * np.eye(2), 1000)
    mixture = fit_mixture(np.concatenate([left, right]), 2, rng)
    order = np.argsort(mixture.means[:, 0])
    assert_allclose(mixture.weights[order], [0.75, 0.25], atol=0.01)
    assert_allclose(mixture.means[order], [[-0.5, 0.0], [0.5, 0.2]], atol=0.02)
    assert_allclose(covariances(mixture)[order], [covariance, 0.01 * np.eye(2)], atol=0.002)


def test_one_component_on_many_points_is_the_maximum_likelihood(rng):
    points = rng.multivariate_normal([0.1, -0.2], [[0.1, 0.05], [0.05, 0.1]], 5000)
    mixture = fit_mixture(points, 1, rng)
    assert_allclose(mixture.means[0], points.mean(axis=0))
    assert_allclose(covariances(mixture)[0], np.cov(points.T), rtol=0.01)


def test_weights_turn_one_distribution_into_another(rng):
    points = rng.uniform(-1.0, 1.0, (20_000, 1))
    weights = np.exp(-0.5 * ((points[:, 0] - 0.3) / 0.1) ** 2)
    mixture = fit_mixture(points, 1, rng, weights=weights)
    assert_allclose(mixture.means, [[0.3]], atol=0.01)
    assert_allclose(mixture.factors, [[[0.1]]], atol=0.005)


def test_only_the_ratios_of_weights_count_and_zero_leaves_a_point_out(rng):
    points = rng.uniform(-1.0, 1.0, (60, 3))
    plain = fit_mixture(points[:50], 4, np.random.default_rng(1))
    weights = np.repeat([7.0, 0.0], [50, 10])
    weighted = fit_mixture(points, 4, np.random.default_rng(1), weights=weights)
    assert_allclose(weighted.means, plain.means)
    assert_allclose(weighted.factors, plain.factors)


def test_two_points_a_component_are_regularised(rng):
    """Bare EM puts a spike on every pair of points, and knows nothing of others."""
    application = AnalyticApplication(dimension=8)
    points = application.sample_fooling_set(100, rng)
    others = application.sample_fooling_set(1000, rng)
    ours = fit_mixture(points, 50, rng).log_density(others).mean()
    bare = GaussianMixture(50, random_state=0).fit(points).score(others)
    uniform = -8 * np.log(2.0)
    assert ours > bare + 100.0
    assert ours > uniform - 2.0


def test_separate_regions_do_not_widen_each_other(rng):
    centres = np.array([[-0.9, -0.9], [0.9, 0.9], [-0.9, 0.9], [0.9, -0.9]])
    points = np.repeat(centres, 10, axis=0) + 0.01 * rng.normal(size=(40, 2))
    deviations = np.sqrt(covariances(fit_mixture(points, 4, rng))[:, [0, 1], [0, 1]])
    assert deviations.max() < 0.1


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((1, 1)),
        np.ones((1, 64)),
        np.full((30, 3), -1.0),
        np.repeat(np.eye(2), 20, axis=0),
        np.linspace(-1.0, 1.0, 5)[:, None] * np.ones(64),
    ],
    ids=["one point", "one in 64", "all equal", "two distinct", "fewer than dimensions"],
)
def test_few_or_equal_points_are_coped_with(points, rng):
    mixture = fit_mixture(points, 50, rng)
    assert len(mixture.weights) <= len(np.unique(points, axis=0))
    samples = mixture.sample(200, rng)
    assert (np.abs(samples) <= 1.0).all()
    assert len(np.unique(samples, axis=0)) == 200
    assert np.isfinite(mixture.log_density(points)).all()


def test_samples_are_truncated_not_clipped(rng):
    samples = single(0.9, 0.25).sample(20_000, rng)[:, 0]
    assert (np.abs(samples) < 1.0).all()
    expected = truncnorm((-1.0 - 0.9) / 0.5, (1.0 - 0.9) / 0.5, 0.9, 0.5)
    assert kstest(samples, expected.cdf).pvalue > 0.01


def test_the_whole_mixture_is_truncated(rng):
    """A component at a face loses half its draws, and so weighs less."""
    mixture = Mixture(np.array([0.5, 0.5]), np.array([[-1.0], [0.5]]), np.full((2, 1, 1), 0.05))
    samples = mixture.sample(20_000, rng)
    assert_allclose((samples < 0.0).mean(), 1 / 3, atol=0.015)
    assert_allclose(mixture.mass_in_box(rng), 0.75, atol=0.02)


def test_a_corner_of_64_dimensions_does_not_hang(rng):
    corner = single(np.ones(64), 0.1 * np.eye(64))
    samples = corner.sample(500, rng)
    assert (np.abs(samples) < 1.0).all()
    assert len(np.unique(samples, axis=0)) == 500
    assert 0.0 < corner.mass_in_box(rng) < 0.001


def test_the_density_is_that_of_the_untruncated_mixture(rng):
    mixture = fit_mixture(rng.uniform(-1.0, 1.0, (40, 2)), 3, rng)
    points = rng.uniform(-2.0, 2.0, (10, 2))
    expected = sum(
        weight * multivariate_normal(mean, covariance).pdf(points)
        for weight, mean, covariance in zip(
            mixture.weights, mixture.means, covariances(mixture), strict=True
        )
    )
    assert_allclose(np.exp(mixture.log_density(points)), expected)


def test_the_held_out_likelihood_chooses_the_size(rng):
    centres = np.array([[-0.7, -0.7], [0.7, 0.7], [-0.7, 0.7], [0.7, -0.7]])
    four = np.repeat(centres, 100, axis=0) + 0.05 * rng.normal(size=(400, 2))
    assert len(fit_best_mixture(four, (1, 2, 4, 64), rng).weights) == 4
    blob = 0.2 * rng.normal(size=(400, 2))
    assert len(fit_best_mixture(blob, (1, 8, 64), rng).weights) == 1
    assert len(fit_best_mixture(blob[:3], (2, 8), rng).weights) == 2


def test_the_held_out_likelihood_is_weighted(rng):
    centres = np.repeat([[-0.7], [0.7]], 200, axis=0)
    points = centres + 0.05 * rng.normal(size=(400, 1))
    weights = np.repeat([1.0, 1e-9], 200)
    assert len(fit_best_mixture(points, (2, 1), rng).weights) == 2
    assert len(fit_best_mixture(points, (2, 1), rng, weights=weights).weights) == 1


def test_same_seed_same_mixture():
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 4))
    first, again = (fit_best_mixture(points, (1, 4), np.random.default_rng(3)) for _ in range(2))
    assert_array_equal(first.factors, again.factors)


def test_arrays_make_an_equal_mixture(rng):
    mixture = fit_mixture(rng.uniform(-1.0, 1.0, (40, 2)), 3, rng)
    again = Mixture.from_arrays(mixture.to_arrays(), 2)
    points = rng.uniform(-1.0, 1.0, (5, 2))
    assert_array_equal(again.log_density(points), mixture.log_density(points))


def test_reflection_at_the_faces():
    points = np.array([[0.0, 1.0, -1.0, 1.5, -1.5, 3.0, 5.0, -7.25]])
    assert_allclose(reflect(points), [[0.0, 1.0, -1.0, 0.5, -0.5, -1.0, 1.0, 0.75]])


@pytest.mark.parametrize(
    ("points", "components", "weights", "message"),
    [
        (np.zeros((0, 2)), 1, None, r"Expected finite points of shape \(n, d\), .* got shape \(0,"),
        (np.zeros(3), 1, None, r"Expected finite points of shape \(n, d\), .* got shape \(3,\)"),
        (np.full((2, 2), np.nan), 1, None, "Expected finite points"),
        (np.zeros((2, 2)), 0, None, "Expected at least 1 component, got 0"),
        (np.zeros((2, 2)), 1, [1.0], r"Expected 2 finite weights .* got shape \(1,\)"),
        (np.zeros((2, 2)), 1, [-1.0, 1.0], "Expected 2 finite weights of at least 0"),
        (np.zeros((2, 2)), 1, [0.0, 0.0], "and one above 0"),
    ],
)
def test_bad_input_is_refused(points, components, weights, message, rng):
    with pytest.raises(ValueError, match=message):
        fit_mixture(points, components, rng, weights=weights)


def test_no_sizes_and_arrays_that_do_not_belong_together_are_refused(rng):
    with pytest.raises(ValueError, match="Expected at least one size"):
        fit_best_mixture(np.zeros((2, 2)), (), rng)
    with pytest.raises(ValueError, match=r"Expected weights \(k,\), means \(k, d\) and factors"):
        Mixture(np.ones(2), np.zeros((1, 3)), np.zeros((1, 3, 3)))
