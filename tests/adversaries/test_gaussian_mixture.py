import numpy as np
import pytest

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.gaussian_mixture import GMM10, GMM50, Gaussian
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.rates import attack_fooling_rate, lead_interval
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle

KINDS = [Gaussian, GMM10, GMM50]


class TestGaussian(AdversaryContract):
    def make(self, dimension, seed):
        return Gaussian(dimension, seed=seed)


class TestGMM10(AdversaryContract):
    def make(self, dimension, seed):
        return GMM10(dimension, seed=seed)


class TestGMM50(AdversaryContract):
    def make(self, dimension, seed):
        return GMM50(dimension, seed=seed)


@pytest.mark.parametrize(
    ("kind", "dimension", "lead", "each"),
    [
        (Gaussian, 2, 0.0, 0.0),
        (Gaussian, 8, 0.25, 0.05),
        (GMM10, 2, 0.8, 0.1),
        (GMM10, 8, 0.3, 0.05),
        (GMM50, 2, 0.8, 0.1),
        (GMM50, 8, 0.25, 0.05),
    ],
)
def test_leads_uniform_samples(kind, dimension, lead, each):
    application = AnalyticApplication(dimension=dimension)
    adversary = kind(dimension, seed=0)
    oracle = RecordingOracle(application, budget=2000)
    adversary.train(oracle)
    assert oracle.remaining == 0
    rng = np.random.default_rng(0)
    uniform = rng.uniform(-1.0, 1.0, (5000, dimension)).astype(np.float32)
    samples = adversary.sample(5000)
    ours, theirs = (
        attack_fooling_rate(application.evaluate(mu, [0] * len(mu)).score, 0.3)
        for mu in (samples, uniform)
    )
    assert lead_interval(ours, theirs)[0] > lead
    region = application.fooling_region(samples)
    assert (np.bincount(region[region >= 0], minlength=4) / len(region)).min() >= each


@pytest.mark.parametrize(
    ("kind", "fooling", "components"),
    [
        (Gaussian, 300, 1),
        (GMM10, 300, 10),
        (GMM10, 62, 6),
        (GMM10, 3, 1),
        (GMM50, 300, 50),
        (GMM50, 7, 4),
        (GMM50, 1, 1),
        (GMM50, 0, 50),
    ],
)
def test_components_are_a_share_of_the_induced_set(kind, fooling, components):
    adversary = kind(8, seed=0)
    adversary.train(FunctionOracle(lambda mu: np.where(np.arange(len(mu)) < fooling, 0, 1), 300))
    assert len(adversary._mixture.weights) == components
    assert adversary.flags == ([] if fooling else [NONE_FOOLED])


def test_the_induced_size_is_an_option():
    adversary = GMM10(2, seed=0, induced_size=40)
    adversary.train(FunctionOracle(lambda mu: np.zeros(len(mu)), 300))
    assert len(adversary._mixture.weights) == 4
    all_of_them = GMM10(2, seed=0, induced_size=0)
    all_of_them.train(FunctionOracle(lambda mu: np.zeros(len(mu)), 300))
    assert len(all_of_them._mixture.weights) == 30


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dimension", [1, 64])
@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_a_constant_score_in_one_dimension_and_in_many(kind, dimension, constant):
    adversary = kind(dimension, seed=0)
    adversary.train(FunctionOracle(lambda mu: np.full(len(mu), constant), 120))
    samples = adversary.sample(50)
    assert samples.shape == (50, dimension)
    assert samples.std() > 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_all_adversaries_share_omega(kind):
    oracle = RecordingOracle(AnalyticApplication(), budget=50)
    kind(2, seed=5).train(oracle)
    expected = np.random.default_rng(5).uniform(-1.0, 1.0, (50, 2)).astype(np.float32)
    assert (oracle.queries == expected).all()


@pytest.mark.parametrize("kind", KINDS)
def test_no_budget_and_no_numbers_are_refused(kind):
    with pytest.raises(ValueError, match="Expected a budget of at least 1 query"):
        kind(2).train(FunctionOracle(lambda mu: np.zeros(len(mu)), 0))
    with pytest.raises(ValueError, match="Expected 10 finite scores"):
        kind(2).train(FunctionOracle(lambda mu: np.full(len(mu), np.nan), 10))


@pytest.mark.parametrize("size", [-1, 2.5, True, "100"])
def test_a_bad_induced_size_is_refused(size):
    with pytest.raises(ValueError, match="Expected induced_size to be an int from 0 to"):
        Gaussian(2, induced_size=size)
