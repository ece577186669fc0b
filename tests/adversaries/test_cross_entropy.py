import numpy as np
import pytest

from sada_gym.adversaries.cross_entropy import CrossEntropy
from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.rates import attack_fooling_rate, lead_interval
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape

QUICK = {"stages": 2, "components": 2}


class TestCrossEntropy(AdversaryContract):
    def make(self, dimension, seed):
        return CrossEntropy(dimension, seed=seed, **QUICK)


def lead_over_uniform(adversary, application, n=5000):
    """Return the samples, and the lower end of their AFR's lead."""
    samples = adversary.sample(n)
    shape = (n, adversary.dimension)
    uniform = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)
    ours, theirs = (
        attack_fooling_rate(application.evaluate(mu, [0] * n).score, 0.3)
        for mu in (samples, uniform)
    )
    return samples, lead_interval(ours, theirs)[0]


def regions(application, samples):
    """Return the share of the samples in each region."""
    region = application.fooling_region(samples)
    return np.bincount(region[region >= 0], minlength=application.regions) / len(region)


@pytest.mark.parametrize(("dimension", "least", "each"), [(2, 0.8, 0.15), (8, 0.4, 0.08)])
def test_leads_uniform_and_covers_all_regions(dimension, least, each):
    application = AnalyticApplication(dimension=dimension)
    adversary = CrossEntropy(dimension, seed=0, stages=3, components=8)
    oracle = RecordingOracle(application, budget=2000)
    adversary.train(oracle)
    assert oracle.remaining == 0
    samples, lead = lead_over_uniform(adversary, application)
    assert lead > least
    assert regions(application, samples).min() >= each


def test_levels_lead_to_a_rare_fooling_set():
    """Of 600 uniform points none or one fools: only the levels tell where to look."""
    application = AnalyticApplication(volume=0.001)
    adversary = CrossEntropy(2, seed=0, components=8)
    adversary.train(RecordingOracle(application, budget=2000))
    assert adversary.flags == []
    assert (adversary.queries.score[:600] <= 0.3).sum() <= 2
    samples, lead = lead_over_uniform(adversary, application)
    assert lead > 0.5
    assert regions(application, samples).min() > 0.05


def test_regions_keep_their_shares_however_often_they_are_drawn_from():
    """Two stripes fool, of one width; in the early levels the right one is many times as wide."""

    def score(mu):
        distance = np.abs(np.abs(mu[:, 0]) - 0.5)
        return np.where(mu[:, 0] < 0.0, np.clip(8.0 * distance - 0.28, 0.0, 1.0), distance)

    adversary = CrossEntropy(2, seed=3)
    oracle = FunctionOracle(score, 1500, threshold=0.04)
    adversary.train(oracle)
    drawn = np.concatenate(oracle.queries[1:3])
    assert (drawn[:, 0] < 0.0).mean() < 0.35
    fooled = adversary.sample(4000)
    fooled = fooled[score(fooled) <= 0.04]
    assert abs((fooled[:, 0] < 0.0).mean() - 0.5) < 0.1


def test_leads_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = CrossEntropy(8, seed=0, **QUICK)
    adversary.train(FunctionOracle(landscape, 2000))
    samples = adversary.sample(2000)
    assert landscape.fooling_rate(samples).mean() > 0.35 + 0.25
    assert samples.std() > 0.4


def test_samples_are_thinned_where_evaluated_points_did_not_fool():
    application = AnalyticApplication()
    adversary = CrossEntropy(2, seed=0, stages=2, components=8)
    adversary.train(RecordingOracle(application, budget=1000))
    thinned = (application.fooling_region(adversary.sample(4000)) >= 0).mean()
    adversary._classes = []
    assert thinned > (application.fooling_region(adversary.sample(4000)) >= 0).mean() + 0.03


@pytest.mark.parametrize("budget", [1, 2, 3, 7, 11, 100])
def test_spends_all_of_the_budget_and_shares_omega(budget):
    oracle = RecordingOracle(AnalyticApplication(), budget=budget)
    adversary = CrossEntropy(2, seed=5, **QUICK)
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

    adversary = CrossEntropy(8, seed=0, **QUICK)
    adversary.train(FunctionOracle(score, 60))
    assert adversary.sample(50).shape == (50, 8)
    assert adversary.flags == ([] if fooling else [NONE_FOOLED])


@pytest.mark.parametrize("dimension", [1, 64])
@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_a_constant_score_in_one_dimension_and_in_many(dimension, constant, tmp_path):
    adversary = CrossEntropy(dimension, seed=0, **QUICK)
    adversary.train(FunctionOracle(lambda mu: np.full(len(mu), constant), 200))
    adversary.save(tmp_path)
    loaded = CrossEntropy.load(tmp_path)
    samples = loaded.sample(50)
    assert (samples == adversary.sample(50)).all()
    assert samples.std() > 0.4


def test_scores_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="Expected 3 finite scores"):
        CrossEntropy(2).train(FunctionOracle(lambda mu: np.full(len(mu), np.nan), 10))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"uniform_share": 1.0}, "uniform_share to be a float between 0 and 1, both excluded"),
        ({"elite": 0.0}, "Expected elite to be a float between 0 and 1"),
        ({"defensive": "0.1"}, "Expected defensive to be a float between 0 and 1"),
        ({"stages": 0}, "Expected stages to be an int from 1 to 1,000, such as 6; got 0"),
        ({"components": 2.5}, "Expected components to be an int"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        CrossEntropy(2, **options)
