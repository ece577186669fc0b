import numpy as np
import pytest

from sada_gym.adversaries import make
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.collapse import collapse_flag
from sada_gym.testing import RecordingOracle


@pytest.mark.parametrize("dimension", [1, 8])
def test_a_point_and_its_surroundings_collapsed(dimension):
    normal = np.random.default_rng(0).normal(size=(250, dimension))
    assert "collapsed to nearly one point" in collapse_flag(0.5 + 0.003 * normal)
    assert "collapsed to nearly one point" in collapse_flag(np.full((250, dimension), 0.3))
    assert collapse_flag(0.05 * normal) is None


def test_one_wide_dimension_or_a_second_point_is_no_collapse():
    rng = np.random.default_rng(0)
    mu = 0.001 * rng.normal(size=(250, 8))
    wide, two = mu.copy(), mu.copy()
    wide[:, 3] = rng.uniform(-1.0, 1.0, 250)
    two[::2] += 0.5
    assert collapse_flag(wide) is None
    assert collapse_flag(two) is None
    assert collapse_flag(rng.uniform(-1.0, 1.0, (250, 8))) is None


def test_a_handful_of_samples_says_nothing():
    assert collapse_flag(np.zeros((9, 2))) is None
    assert collapse_flag(np.zeros((10, 2))) is not None
    assert collapse_flag(np.zeros((0, 2))) is None


def test_the_default_adversary_after_five_queries_is_flagged():
    adversary = make("bbgan", 2, seed=0, steps=150)
    adversary.train(RecordingOracle(AnalyticApplication(), budget=5))
    assert collapse_flag(adversary.sample(250)) is not None


@pytest.mark.parametrize("mu", [np.zeros(3), np.zeros((20, 0)), np.full((20, 2), np.nan)])
def test_what_is_no_sample_is_refused(mu):
    with pytest.raises(ValueError, match="Expected finite mu of shape"):
        collapse_flag(mu)
