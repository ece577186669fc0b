import numpy as np
import pytest

from sada_gym.adversaries.level_set import LevelSet
from sada_gym.adversaries.sada import SADA
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.testing import AdversaryContract
from sada_gym.testing.landscapes import FunctionOracle
from sada_gym.testing.scales import scales


class TestLevelSet(AdversaryContract):
    budget = 100

    def make(self, dimension, seed):
        return LevelSet(dimension, seed=seed, rounds=1, models=["trees"])


def trained(kind, score, threshold, budget, dimension=2):
    adversary = kind(dimension, seed=0, rounds=1)
    adversary.train(FunctionOracle(score, budget, threshold))
    return adversary


def test_its_queries_and_samples_are_the_same_on_every_scale():
    boxes = AnalyticApplication(dimension=2)

    def score(mu):
        return boxes.evaluate(mu, range(len(mu))).score

    uniform = np.random.default_rng(1).uniform(-1.0, 1.0, (5_000, 2))
    first, *others = [
        trained(LevelSet, lambda mu, m=scale.map: m(score(mu)), float(scale.map(0.3)), 200)
        for scale in scales(score(uniform))
    ]
    samples = first.sample(50)
    for other in others:
        assert (other.omega.mu == first.omega.mu).all()
        assert (other.sample(50) == samples).all()


def test_it_holds_where_a_softmax_decides_and_the_threshold_is_tiny():
    image = DigitsApplication(image=135, parameters=("rotation_deg", "scale"))

    def score(mu):
        return image.evaluate(mu, [0] * len(mu)).score

    uniform = np.random.default_rng(2).uniform(-1.0, 1.0, (5_000, 2)).astype(np.float32)
    threshold = float(np.quantile(score(uniform), 0.1))
    assert threshold < 0.001
    rates = {
        kind: (score(trained(kind, score, threshold, 400).sample(250)) <= threshold).mean()
        for kind in (LevelSet, SADA)
    }
    assert rates[LevelSet] > 0.9
    assert rates[LevelSet] > rates[SADA]


@pytest.mark.parametrize("bad", [{"rounds": -1}, {"models": ["forest"]}])
def test_bad_options_are_refused(bad):
    with pytest.raises(ValueError, match=r"Expected (rounds|models) to be"):
        LevelSet(2, **bad)
