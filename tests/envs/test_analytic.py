"""SADA-Analytic: the known fooling set is what `evaluate` says it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.testing import ApplicationContract

DIMENSIONS = (1, 2, 3, 8, 16, 40)


class TestContract(ApplicationContract):
    def make(self) -> AnalyticApplication:
        return AnalyticApplication()


def uniform(application: AnalyticApplication, n: int) -> np.ndarray:
    shape = (n, len(application.parameters))
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


@pytest.mark.parametrize("regions", [1, 4, 5, 12])
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_volume_is_exact_in_every_dimension(dimension: int, regions: int) -> None:
    application = AnalyticApplication(dimension=dimension, regions=regions, volume=0.1)
    sides = 2 * application.half_sides
    assert regions * np.prod(sides / 2) == pytest.approx(0.1, rel=1e-12)
    n, some = 40_000, 2_000
    mu = uniform(application, n)
    inside = application.fooling_region(mu) >= 0
    assert inside.mean() == pytest.approx(0.1, abs=4 * (0.1 * 0.9 / n) ** 0.5)
    # an evaluation makes an info as well, which takes longer than the score
    assert_array_equal(application.evaluate(mu[:some], [0] * some).fooled, inside[:some])


@pytest.mark.parametrize("regions", [1, 4, 5, 12])
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_regions_lie_inside_and_apart(dimension: int, regions: int) -> None:
    application = AnalyticApplication(dimension=dimension, regions=regions)
    centres, half_sides = application.centres, application.half_sides
    assert (np.abs(centres) + half_sides < 1).all()
    gaps = np.abs(centres[:, None] - centres[None]) - 2 * half_sides
    gaps = gaps.max(axis=2)[~np.eye(regions, dtype=bool)]
    assert (gaps > 0).all()


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_samples_of_the_fooling_set_fool_and_cover_it(dimension: int) -> None:
    application = AnalyticApplication(dimension=dimension, regions=5)
    mu = application.sample_fooling_set(5_000, np.random.default_rng(1))
    assert mu.dtype == np.float32
    outcomes = application.evaluate(mu, [0] * len(mu))
    assert outcomes.fooled.all()
    regions = application.fooling_region(mu)
    assert_array_equal(regions, [info["region"] for info in outcomes.infos])
    assert np.bincount(regions).min() > 800
    spread = (mu - application.centres[regions]) / application.half_sides
    assert np.abs(spread.mean(axis=0)).max() < 5 / (3 * len(mu)) ** 0.5
    assert np.abs(spread.var(axis=0) - 1 / 3).max() < 0.03


def test_fooling_region_is_minus_one_outside() -> None:
    application = AnalyticApplication()
    mu = uniform(application, 5_000)
    fooled = application.evaluate(mu, [0] * len(mu)).fooled
    assert_array_equal(application.fooling_region(mu) >= 0, fooled)


def test_the_score_is_zero_at_a_centre_and_the_threshold_on_the_surface() -> None:
    application = AnalyticApplication(regions=1)
    centre = application.centres[0]
    surface = centre + np.array([application.half_sides[0], 0])
    score = application.evaluate([centre, surface], [0, 0]).score
    assert score[0] == pytest.approx(0, abs=1e-12)
    assert score[1] == pytest.approx(0.3, abs=1e-6)


def test_noise_comes_from_the_seed_and_is_bounded() -> None:
    quiet, noisy = AnalyticApplication(), AnalyticApplication(noise=0.1)
    mu = uniform(quiet, 200)
    seeds = list(range(200))
    difference = noisy.evaluate(mu, seeds).score - quiet.evaluate(mu, seeds).score
    assert np.abs(difference).max() <= 0.1 + 1e-12
    assert len(np.unique(difference)) > 100
    assert_array_equal(quiet.evaluate(mu, seeds).score, quiet.evaluate(mu, seeds[::-1]).score)


@pytest.mark.parametrize("dimension", [1, 2, 16])
def test_the_picture_marks_mu(dimension: int) -> None:
    application = AnalyticApplication(dimension=dimension)
    frame = application.render(np.zeros(dimension), 0)
    assert frame.shape == (128, 128, 3)
    assert frame.dtype == np.uint8
    assert (frame[64, 64] == 0).all()
    assert (application.render(np.ones(dimension), 0) != frame).any()


def test_golden_scores() -> None:
    application = AnalyticApplication(dimension=3, regions=5, volume=0.2, noise=0.05)
    mu = [[0, 0, 0], [0.5, -0.25, 0.75], [-1, 1, -1]]
    golden = [0.1121098492507911, 0.4496544214747435, 0.6327621548838323]
    assert application.evaluate(mu, [0, 1, 2]).score == pytest.approx(golden, abs=1e-12)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"dimension": 0}, "Expected dimension to be an int of at least 1, got 0"),
        ({"dimension": 2.0}, "Expected dimension to be an int of at least 1, got 2.0"),
        ({"regions": 0}, "Expected regions to be an int of at least 1, got 0"),
        ({"volume": 0.0}, r"Expected volume to be a share within \(0, 1\), got 0.0"),
        ({"volume": float("nan")}, r"Expected volume to be a share within \(0, 1\), got nan"),
        ({"dimension": 10**6}, "Expected dimension of at most 1,000, got 1,000,000"),
        ({"regions": 10**9}, "Expected regions of at most 1,000, got 1,000,000,000"),
        ({"volume": "0.1"}, "Expected volume to be a number, got '0.1'"),
        ({"noise": None}, "Expected noise to be a number, got None"),
        ({"noise": 1.0}, r"Expected noise to be within \[0, 1\), got 1.0"),
    ],
)
def test_bad_keywords_are_refused(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AnalyticApplication(**keywords)


def test_the_largest_one_fits_in_memory() -> None:
    application = AnalyticApplication(dimension=1_000, regions=1_000)
    mu = uniform(application, 33)
    one_by_one = [application.evaluate(row[None], [0]).score[0] for row in mu[:3]]
    assert_array_equal(application.evaluate(mu, [0] * 33).score[:3], one_by_one)
