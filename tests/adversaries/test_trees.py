import numpy as np
import pytest

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.trees import Trees
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle


class TestTrees(AdversaryContract):
    def make(self, dimension, seed):
        return Trees(dimension, seed=seed, trees=20)


def test_it_finds_every_region_from_uniform_queries():
    boxes = AnalyticApplication(dimension=2)
    oracle = RecordingOracle(boxes, budget=800)
    adversary = Trees(2, seed=0)
    adversary.train(oracle)
    uniform = np.random.default_rng(0).uniform(-1.0, 1.0, (800, 2)).astype(np.float32)
    assert (oracle.queries == uniform).all()
    samples = adversary.sample(250)
    assert attack_fooling_rate(boxes.evaluate(samples, range(250)).score, 0.3).low > 0.85
    assert set(boxes.fooling_region(samples)) >= set(range(4))


def test_where_nothing_fooled_it_takes_the_lowest_scores():
    adversary = Trees(2, seed=0, trees=50)
    adversary.train(FunctionOracle(lambda mu: 0.5 + np.abs(mu).max(axis=1) / 2, 500))
    assert adversary.flags == [NONE_FOOLED]
    assert np.abs(adversary.sample(100)).max() < 0.5


def test_the_likeliest_are_taken_where_no_candidate_reaches_the_level():
    adversary = Trees(6, seed=0, trees=50, level=1.0)
    adversary.train(FunctionOracle(lambda mu: np.random.default_rng(0).random(len(mu)), 300))
    assert adversary.sample(50).shape == (50, 6)


@pytest.mark.parametrize("bad", [{"trees": 0}, {"level": 1.5}, {"trees": 2.5}])
def test_bad_options_are_refused(bad):
    with pytest.raises(ValueError, match=r"Expected (trees|level) to be"):
        Trees(2, **bad)
