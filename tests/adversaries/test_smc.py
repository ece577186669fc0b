import numpy as np
import pytest

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.smc import SMC
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.evaluations import Evaluations
from sada_gym.measures.rates import attack_fooling_rate, lead_interval
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape


class TestSMC(AdversaryContract):
    def make(self, dimension, seed):
        return SMC(dimension, seed=seed)


@pytest.mark.parametrize(
    ("dimension", "volume", "least", "regions"),
    [(2, 0.1, 0.85, 4), (8, 0.1, 0.7, 4), (2, 0.001, 0.8, 2), (8, 0.001, 0.8, 2)],
)
def test_leads_uniform_and_covers_regions(dimension, volume, least, regions):
    """Of the rare sets, 0.1 % of the box, a uniform pool of 600 points knows about none."""
    application = AnalyticApplication(dimension=dimension, volume=volume)
    adversary = SMC(dimension, seed=0)
    oracle = RecordingOracle(application, budget=2000)
    adversary.train(oracle)
    assert oracle.remaining == 0
    assert adversary.flags == []
    samples = adversary.sample(5000)
    shape = (5000, dimension)
    uniform = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    ours, theirs = (
        attack_fooling_rate(application.evaluate(mu, [0] * len(mu)).score, 0.3)
        for mu in (samples, uniform)
    )
    assert lead_interval(ours, theirs)[0] > least
    region = application.fooling_region(samples)
    shares = np.bincount(region[region >= 0], minlength=4) / len(region)
    assert (shares > 0.05).sum() >= regions


def test_leads_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = SMC(8, seed=0)
    adversary.train(FunctionOracle(landscape, 2000))
    samples = adversary.sample(2000)
    assert landscape.fooling_rate(samples).mean() > 0.35 + 0.35
    assert samples.std() > 0.45


def test_chains_keep_to_the_odds_of_fooling():
    """On the right nine of ten worlds fool, on the left one: so shall the states be."""
    rng = np.random.default_rng(1)

    def score(mu):
        return np.where(rng.random(len(mu)) < np.where(mu[:, 0] > 0.0, 0.9, 0.1), 0.0, 1.0)

    mu = rng.uniform(-1.0, 1.0, (40_000, 1)).astype(np.float32)
    pool = Evaluations.unseeded(mu, score(mu))
    fooled = Evaluations.unseeded(mu[pool.score <= 0.3], pool.score[pool.score <= 0.3])
    adversary = SMC(1, seed=0, steps=50)
    adversary._scale = 0.5
    states, queries = adversary._walk(fooled, 0.3, 200_000, FunctionOracle(score, 200_000))
    assert len(states) == len(queries) == 200_000
    assert abs((states.mu > 0.0).mean() - 0.9) < 0.01
    # a chain that dropped states on a second look would be off
    assert abs((queries.mu[queries.score <= 0.3] > 0.0).mean() - 0.9) > 0.02


def test_samples_lie_between_neighbours_that_fooled():
    def score(mu):
        return np.where(np.abs(np.abs(mu[:, 0]) - 0.5) < 0.1, 0.0, 1.0)

    adversary = SMC(2, seed=0)
    adversary.train(FunctionOracle(score, 1000))
    samples = adversary.sample(2000)
    assert (score(samples) == 0.0).all()
    assert 0.2 < (samples[:, 0] > 0.0).mean() < 0.8


@pytest.mark.parametrize("budget", [1, 2, 3, 7, 11, 100])
def test_spends_all_of_the_budget_and_shares_omega(budget):
    oracle = RecordingOracle(AnalyticApplication(), budget=budget)
    adversary = SMC(2, seed=5)
    adversary.train(oracle)
    assert oracle.remaining == 0
    assert (adversary.queries.mu == oracle.queries).all()
    first = int(np.ceil(0.3 * budget))
    expected = np.random.default_rng(5).uniform(-1.0, 1.0, (first, 2)).astype(np.float32)
    assert (oracle.queries[:first] == expected).all()


@pytest.mark.parametrize("fooling", [0, 1, 5, 60])
def test_few_fooling_points_or_none_or_only_such(fooling):
    left = [fooling]

    def score(mu):
        here = np.where(np.arange(len(mu)) < left[0], 0.1, 0.5 + 0.1 * mu[:, 0])
        left[0] = max(0, left[0] - len(mu))
        return here

    adversary = SMC(8, seed=0)
    adversary.train(FunctionOracle(score, 60))
    assert adversary.sample(50).shape == (50, 8)
    assert adversary.flags == ([] if fooling else [NONE_FOOLED])


@pytest.mark.parametrize("dimension", [1, 64])
@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_a_constant_score_in_one_dimension_and_in_many(dimension, constant):
    adversary = SMC(dimension, seed=0)
    adversary.train(FunctionOracle(lambda mu: np.full(len(mu), constant), 200))
    samples = adversary.sample(50)
    assert samples.shape == (50, dimension)
    assert samples.std() > 0.3


def test_scores_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="Expected 3 finite scores"):
        SMC(2).train(FunctionOracle(lambda mu: np.full(len(mu), np.nan), 10))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"uniform_share": 0.0}, "uniform_share to be a float between 0 and 1, both excluded"),
        ({"level_share": 1.0}, "Expected level_share to be a float between 0 and 1"),
        ({"level_probability": 2}, "Expected level_probability to be a float between 0 and 1"),
        ({"acceptance": "0.3"}, "Expected acceptance to be a float between 0 and 1"),
        ({"steps": 0}, "Expected steps to be an int from 1 to 10,000, such as 5; got 0"),
        ({"neighbours": True}, "Expected neighbours to be an int"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        SMC(2, **options)
