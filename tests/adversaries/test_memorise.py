import numpy as np

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.memorise import MEMORISED, Memorise
from sada_gym.testing import AdversaryContract
from studies.landscapes import FunctionOracle


class TestArchive(AdversaryContract):
    continuous = False

    def make(self, dimension, seed):
        return Memorise(dimension, seed=seed)

    def test_samples_are_all_the_queries_that_fooled_each_once_before_any_again(self):
        adversary, oracle = self.train()
        fooled = adversary.queries.mu[adversary.queries.score <= oracle.threshold]
        k = len(fooled)
        samples = adversary.sample(2 * k + 1)
        expected = np.unique(fooled, axis=0)
        assert (np.unique(samples[:k], axis=0) == expected).all()
        assert (np.unique(samples[k : 2 * k], axis=0) == expected).all()
        assert (samples[:k] != samples[k : 2 * k]).any()
        assert len(oracle.queries) == self.budget
        assert adversary.flags == [MEMORISED]


def test_without_a_fooling_point_the_lowest_scores_are_replayed():
    adversary = Memorise(3, seed=0)
    adversary.train(FunctionOracle(lambda mu: 0.5 + 0.1 * mu[:, 0], 500))
    assert adversary.flags == [MEMORISED, NONE_FOOLED]
    lowest = np.sort(adversary.queries.mu[:, 0])[:100]
    assert (np.sort(adversary.sample(100)[:, 0]) == lowest).all()


def test_constant_scores():
    for score, flags in ((0.0, [MEMORISED]), (1.0, [MEMORISED, NONE_FOOLED])):
        adversary = Memorise(64, seed=0)
        adversary.train(FunctionOracle(lambda mu, score=score: np.full(len(mu), score), 30))
        assert len(np.unique(adversary.sample(30), axis=0)) == 30
        assert adversary.flags == flags
