import numpy as np
import pytest
from prdc import compute_prdc

from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures import coverage as module
from sada_gym.measures.coverage import (
    density_and_coverage,
    expected_coverage,
    fooling_coverage,
    reference_draws,
    relative_coverage,
)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def prdc(real, fake, k=5):
    measured = compute_prdc(real, fake, nearest_k=k)
    return measured["density"], measured["coverage"]


@pytest.mark.parametrize(
    ("n", "m", "d", "k", "width"),
    [(250, 250, 8, 5, 1.0), (250, 90, 8, 5, 0.3), (40, 60, 2, 3, 0.5), (60, 60, 64, 5, 1.0)],
)
def test_it_equals_prdc(rng, n, m, d, k, width):
    real, fake = rng.normal(size=(n, d)), width * rng.normal(size=(m, d))
    got = density_and_coverage(real, fake, k)
    assert 0 < got.coverage < 1
    assert (got.density, got.coverage) == pytest.approx(prdc(real, fake, k), abs=1e-9)


def test_it_equals_prdc_where_points_coincide_and_distances_tie(rng):
    real, fake = (rng.integers(0, 4, (200, 3)).astype(float) for _ in range(2))
    got = density_and_coverage(real, fake)
    assert 0 < got.coverage < 1
    assert (got.density, got.coverage) == pytest.approx(prdc(real, fake), abs=1e-9)


def test_blocks_change_nothing(rng, monkeypatch):
    real, fake = rng.normal(size=(70, 4)), rng.normal(size=(50, 4))
    whole = density_and_coverage(real, fake)
    monkeypatch.setattr(module, "_BLOCK", 333)
    assert density_and_coverage(real, fake) == whole


def test_coinciding_points_are_never_covered():
    point = np.full((6, 2), 0.5)
    assert density_and_coverage(point, point).coverage == 0.0
    point[5] = 0.0  # gives the five others a radius; it has all samples on its own sphere
    assert density_and_coverage(point, point[:5]).coverage == 5 / 6


def test_no_samples_cover_nothing(rng):
    got = density_and_coverage(rng.normal(size=(20, 3)), np.zeros((0, 3)))
    assert (got.density, got.coverage) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("real", "fake", "k", "message"),
    [
        (np.zeros((5, 2)), np.zeros((9, 2)), 5, r"at least k \+ 1 = 6 reference points .* got 5"),
        (np.zeros((9, 2)), np.zeros((9, 2)), 0, "k >= 1"),
        (np.zeros((9, 2)), np.zeros((9, 3)), 5, r"got \(9, 2\) and \(9, 3\)"),
        (np.zeros((9, 2)), np.zeros(2), 5, r"got \(9, 2\) and \(2,\)"),
        (np.zeros((9, 2)), np.full((9, 2), np.nan), 5, "finite points"),
    ],
)
def test_bad_points_are_refused(real, fake, k, message):
    with pytest.raises(ValueError, match=message):
        density_and_coverage(real, fake, k)


@pytest.mark.parametrize(("real", "fake"), [(250, 250), (100, 400), (250, 20)])
def test_expected_coverage_is_the_mean_coverage_of_the_truth(rng, real, fake):
    measured = [
        density_and_coverage(rng.normal(size=(real, 3)), rng.normal(size=(fake, 3))).coverage
        for _ in range(60)
    ]
    tolerance = 4 * np.std(measured) / np.sqrt(len(measured))
    assert np.mean(measured) == pytest.approx(expected_coverage(real, fake), abs=tolerance)


def test_expected_coverage_by_hand():
    assert expected_coverage(2, 1, 1) == pytest.approx(1 - 1 / 2)
    assert expected_coverage(10, 0) == 0.0
    with pytest.raises(ValueError, match="k \\+ 1 = 6 reference points"):
        expected_coverage(5, 5)
    with pytest.raises(ValueError, match="at least 0 samples"):
        expected_coverage(9, -1)


def analytic(rng, points=4_000, dimension=8):
    application = AnalyticApplication(dimension=dimension, regions=4, volume=0.05)
    return application, application.sample_fooling_set(points, rng)


def test_the_truth_covers_the_fooling_set_as_ideal_samples_do(rng):
    application, reference = analytic(rng)
    ideal = application.sample_fooling_set(250, rng)
    got = fooling_coverage(ideal, np.ones(250, bool), reference)
    assert (got.points, got.draws) == (250, 20)
    assert got.coverage == pytest.approx(expected_coverage(250, 250), abs=0.02)
    assert got.density == pytest.approx(1.0, abs=0.1)
    assert relative_coverage(got.coverage, expected_coverage(250, 250)) == pytest.approx(
        1, abs=0.02
    )


def test_collapsed_samples_cover_next_to_nothing(rng):
    application, reference = analytic(rng)
    point = application.sample_fooling_set(1, rng)
    collapsed = point + 0.01 * rng.normal(size=(250, 8))
    assert fooling_coverage(collapsed, np.ones(250, bool), reference).coverage < 0.1


def test_one_region_of_four_covers_a_quarter(rng):
    application, reference = analytic(rng, dimension=2)
    samples = application.sample_fooling_set(2_000, rng)
    samples = samples[application.fooling_region(samples) == 2][:250]
    got = fooling_coverage(samples, np.ones(250, bool), reference)
    assert got.coverage == pytest.approx(0.25, abs=0.03)


def test_only_samples_that_fool_count(rng):
    application, reference = analytic(rng)
    ideal = application.sample_fooling_set(250, rng)
    assert fooling_coverage(ideal, np.zeros(250, bool), reference).coverage == 0.0
    tenth = np.arange(250) < 25
    got = fooling_coverage(ideal, tenth, reference).coverage
    assert got == pytest.approx(expected_coverage(250, 25), abs=0.05)
    elsewhere = np.where(tenth[:, None], ideal, 0.0)
    assert fooling_coverage(elsewhere, tenth, reference).coverage == got


def test_the_draws_are_the_same_for_all_adversaries_and_others_for_another_seed():
    draws = reference_draws(1_000, 250, draws=20, seed=3)
    assert draws.shape == (20, 250)
    assert all(len(set(rows)) == 250 for rows in draws.tolist())
    assert (draws[0] != draws[1]).any()
    np.testing.assert_array_equal(draws, reference_draws(1_000, 250, draws=20, seed=3))
    assert (draws != reference_draws(1_000, 250, draws=20, seed=4)).any()


def test_the_seed_fixes_the_figure(rng):
    application, reference = analytic(rng, 600)
    samples, fooled = application.sample_fooling_set(250, rng), rng.random(250) < 0.5
    first = fooling_coverage(samples, fooled, reference, seed=1)
    assert first == fooling_coverage(samples, fooled, reference, seed=1)
    assert first != fooling_coverage(samples, fooled, reference, seed=2)


def test_a_small_fooling_set_is_taken_whole(rng):
    application, reference = analytic(rng, 60)
    ideal = application.sample_fooling_set(250, rng)
    got = fooling_coverage(ideal, np.ones(250, bool), reference)
    assert got.points == 60
    assert got.coverage == density_and_coverage(reference, ideal).coverage
    assert got.coverage == pytest.approx(expected_coverage(60, 250), abs=0.02)
    with pytest.raises(ValueError, match="reference points"):
        fooling_coverage(ideal, np.ones(250, bool), reference[:5])


@pytest.mark.parametrize("fooled", [np.ones(9, bool), np.ones(10), np.ones((10, 1), bool)])
def test_a_bad_mask_is_refused(rng, fooled):
    with pytest.raises(ValueError, match=r"Expected fooled of shape \(10,\) with bools"):
        fooling_coverage(rng.normal(size=(10, 2)), fooled, rng.normal(size=(20, 2)))


def test_bad_settings_are_refused(rng):
    points = rng.normal(size=(10, 2))
    with pytest.raises(ValueError, match="at least one sample"):
        fooling_coverage(np.zeros((0, 2)), np.zeros(0, bool), points)
    with pytest.raises(ValueError, match="at least 1 draw"):
        fooling_coverage(points, np.ones(10, bool), points, draws=0)
    with pytest.raises(ValueError, match="ideal coverage"):
        relative_coverage(0.5, 0.0)
