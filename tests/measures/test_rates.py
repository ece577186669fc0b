import numpy as np
import pytest
from scipy.stats import binomtest

from sada_gym.measures.rates import (
    attack_fooling_rate,
    lead_interval,
    mu_std,
    nearest_neighbours,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "trials"), [(8, 10), (186, 250), (0, 100), (100, 100), (1, 2)]
)
def test_wilson_interval_is_scipys(successes, trials):
    scipys = binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx(tuple(scipys), abs=1e-12)


@pytest.mark.parametrize(("successes", "trials"), [(3, 2), (-1, 2), (0, 0)])
def test_wilson_interval_refuses(successes, trials):
    with pytest.raises(ValueError, match="successes <= trials"):
        wilson_interval(successes, trials)


def test_fooling_rate_counts_the_threshold_itself():
    rate = attack_fooling_rate([0.0, 0.3, 0.3000001, 1.0], 0.3)
    assert (rate.fooled, rate.samples, rate.rate) == (2, 4, 0.5)
    assert rate.low < 0.5 < rate.high
    assert str(attack_fooling_rate([0.0] * 186 + [1.0] * 64, 0.3)) == "74.4 % (68.6 to 79.4)"


@pytest.mark.parametrize("scores", [[], [np.nan], [[0.1]]])
def test_fooling_rate_refuses(scores):
    with pytest.raises(ValueError, match="Expected scores"):
        attack_fooling_rate(scores, 0.3)


def test_lead_interval_of_newcombes_example():
    """Newcombe 1998, table II, case a, method 10: 56 of 70 against 48 of 80."""
    ours = attack_fooling_rate([0.0] * 56 + [1.0] * 14, 0.3)
    theirs = attack_fooling_rate([0.0] * 48 + [1.0] * 32, 0.3)
    assert lead_interval(ours, theirs) == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_mu_std():
    uniform = np.random.default_rng(0).uniform(-1, 1, (100_000, 2))
    assert mu_std(uniform) == pytest.approx(0.577, abs=0.002)
    assert mu_std(np.ones((5, 3))) == 0.0
    assert mu_std([[-1.0, 0.0], [1.0, 0.0]]) == 0.5
    with pytest.raises(ValueError, match="Expected mu of shape"):
        mu_std(np.zeros(3))


def test_nearest_neighbours():
    distances, indices = nearest_neighbours([[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.5], [0.3, 0.4]])
    np.testing.assert_allclose(distances, [0.5, 0.5])
    assert indices.tolist() == [1, 0]
    with pytest.raises(ValueError, match=r"got \(1, 2\) and \(1, 3\)"):
        nearest_neighbours(np.zeros((1, 2)), np.zeros((1, 3)))
