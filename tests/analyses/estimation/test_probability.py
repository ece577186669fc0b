"""Small probabilities of failure: true ones are held, hidden ones are allowed for, none is sure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from sada_gym.analyses.estimation.core import Answers, estimate_probability
from sada_gym.analyses.estimation.core import _found as counted
from sada_gym.analyses.estimation.core import _guided as guided
from sada_gym.analyses.estimation.interval import exact_interval, gamma_interval
from sada_gym.analyses.estimation.model import Scale


class Normal:
    """Ordinary use that is standard normal."""

    def __init__(self, dimension):
        self.dimension = dimension

    def sample(self, count, rng):
        return rng.normal(size=(count, self.dimension))

    def log_density(self, z):
        return norm.logpdf(z).sum(axis=1)


def asker(margin, *, invalid=0.0, flat=False, seed=0):
    """Score worlds that fail where the margin is negative."""
    rng = np.random.default_rng(seed)

    def ask(z, plain):
        m = margin(z)
        score = np.where(m > 0.0, 1.0, 0.0) if flat else np.clip(0.5 + 0.1 * m, 0.0, 1.0)
        valid = rng.random(len(z)) >= invalid
        return Answers(score, (m <= 0.0) & valid, valid)

    return ask


def found(margin, dimension, budget=1_000, seed=0, **given):
    rng = np.random.default_rng(seed)
    return estimate_probability(Normal(dimension), asker(margin, **given), 0.5, budget, rng)


@pytest.mark.long
def test_a_rare_failure_in_many_dimensions_is_found_and_held():
    result = found(lambda z: 3.72 - z[:, :4].sum(axis=1) / 2.0, 8)
    truth = norm.sf(3.72)  # 1e-4
    assert result.refused is None
    assert result.interval[0] <= truth <= result.interval[1] < 2.0 * truth
    assert result.probability == pytest.approx(truth, rel=0.3)
    plain = result.failed[: result.plain].sum()
    assert plain <= 2  # nearly all failures are of guided draws
    assert result.failed.sum() > 50


@pytest.mark.long
def test_regions_apart_all_count():
    result = found(lambda z: 3.3 - np.abs(z[:, 0]), 4, seed=1)
    assert result.probability == pytest.approx(2.0 * norm.sf(3.3), rel=0.3)


@pytest.mark.long
def test_a_region_that_no_score_shows_widens_the_interval():
    def margin(z):
        hidden = np.linalg.norm(z[:, :2] + 1.0, axis=1) < 0.25
        return np.where(hidden, -1.0, 2.6 - z[:, 0])

    rng = np.random.default_rng(1)
    truth = (margin(rng.normal(size=(2_000_000, 3))) <= 0.0).mean()
    result = found(margin, 3, seed=2)
    low, high = result.interval
    assert low <= truth <= high
    assert high > 2.0 * norm.sf(2.6)  # what a model alone would say


def test_where_nothing_fails_the_rule_of_three_holds():
    result = found(lambda z: np.full(len(z), 1.0), 2, budget=400)
    assert (result.probability, result.interval[0]) == (0.0, 0.0)
    assert result.interval[1] >= 3.0 / len(result.z)
    assert not result.learnt


@pytest.mark.parametrize("budget", [20, 400])
def test_where_everything_fails_it_says_so(budget):
    result = found(lambda z: np.full(len(z), -1.0), 2, budget=budget)
    assert result.probability == pytest.approx(1.0, abs=0.1)
    assert result.interval[0] > 0.7
    assert result.interval[1] == pytest.approx(1.0, abs=0.01)


def test_scores_without_a_slope_are_no_obstacle():
    result = found(lambda z: 1.6 - z[:, 0], 2, flat=True)
    assert result.interval[0] <= norm.sf(1.6) <= result.interval[1]


@pytest.mark.long
def test_invalid_worlds_are_none_of_ordinary_use():
    result = found(lambda z: 1.0 - z[:, 0], 2, budget=2_000, invalid=0.15)
    assert result.probability == pytest.approx(norm.sf(1.0), rel=0.15)
    assert result.interval[0] <= norm.sf(1.0) <= result.interval[1]


@pytest.mark.long
def test_a_model_that_is_wrong_costs_precision_and_no_truth(monkeypatch):
    class Wrong:
        def depth(self, z):
            return -2.0 - 2.0 * z[:, 0]  # expects failures at the other end

    monkeypatch.setattr("sada_gym.analyses.estimation.core._LAST_CANDIDATES", 2_000)
    monkeypatch.setattr("sada_gym.analyses.estimation.proposal._SEARCHED", 500)
    truth = norm.sf(1.3)
    results = [
        guided(Normal(2), Wrong(), asker(lambda z: 1.3 - z[:, 0]), 800, np.random.default_rng(i))
        for i in range(12)
    ]
    assert np.mean([result.probability for result in results]) == pytest.approx(truth, rel=0.15)
    held = [result.interval[0] <= truth <= result.interval[1] for result in results]
    assert sum(held) >= 10


def test_one_heavy_draw_is_refused(monkeypatch):
    class Blind:
        def depth(self, z):
            return np.where(z[:, 0] < -2.0, 1.0, -9.0)

    monkeypatch.setattr("sada_gym.analyses.estimation.core._LAST_CANDIDATES", 2_000)
    ask = asker(lambda z: 2.2 - z[:, 0])
    tries = (guided(Normal(2), Blind(), ask, 400, np.random.default_rng(i)) for i in range(9))
    result = next(one for one in tries if 0 < one.failed.sum() < 5)
    assert "failures of plain draws" in result.refused


def test_failures_whose_weights_underflow_are_refused_in_words():
    everything = np.ones(4, np.bool_)
    answers = Answers(np.zeros(4), everything, everything)
    result = counted(np.zeros((4, 2)), np.zeros(4), answers, 2, 0.0, learnt=True)
    assert result.probability == 0.0
    assert result.interval[1] > 0.5
    assert "0 failures of plain draws, and 100 % of it" in result.refused


def test_the_interval_of_equal_weights_is_that_of_a_count():
    low, high = gamma_interval(0.005, 0.005 / 1_000, 0.001)  # 5 of 1,000
    exact = exact_interval(5, 1_000)
    assert (low, high) == pytest.approx(exact, rel=0.03)
    assert gamma_interval(0.0, 0.0, 0.001)[1] == pytest.approx(3.69e-3, rel=0.01)


@pytest.mark.parametrize("scores", [np.zeros(50), np.repeat([0.0, 1.0], 25), np.arange(50) / 50])
def test_a_scale_ascends_and_goes_on_beyond_its_ends(scores):
    heights = Scale(scores)(np.linspace(-2.0, 3.0, 101))
    assert np.isfinite(heights).all()
    assert (np.diff(heights) >= 0.0).all()
    assert heights[0] < heights[-1]
