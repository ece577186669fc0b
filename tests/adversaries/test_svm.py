import numpy as np
import pytest
from sklearn.svm import SVC

from sada_gym.adversaries import svm
from sada_gym.adversaries.selection import NONE_FOOLED_BUT_ALL_LEARNT
from sada_gym.adversaries.svm import ONE_CLASS, SVM
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape


class TestSVM(AdversaryContract):
    uses_values = True

    def make(self, dimension, seed):
        return SVM(dimension, seed=seed, subset=50)


def trained(score, budget=300, dimension=2, **options):
    adversary = SVM(dimension, seed=0, **options)
    adversary.train(FunctionOracle(score, budget))
    return adversary


@pytest.mark.parametrize("classes", [2, 3, 5])
def test_predicts_as_scikit_learn_does(classes, monkeypatch):
    """Our own prediction, blocks and all, from the arrays that are saved."""
    monkeypatch.setattr(svm, "_BLOCK", 64)
    machines = []
    monkeypatch.setattr(
        svm, "_machine", lambda c, g: machines.append(SVC(C=c, gamma=g)) or machines[-1]
    )

    def score(mu):
        return 0.99 * np.clip(np.linalg.norm(mu, axis=1), 0, 1) * classes / 5

    adversary = trained(score)
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (1000, 2))
    expected = machines[-1].predict(points * np.sqrt(3.0))
    assert set(expected) == set(range(classes))
    assert (adversary._predict(points) == expected).all()


def test_bins_are_fifths():
    score = np.linspace(0.0, 1.0, 101)
    oracle = FunctionOracle(lambda mu: score, 101)
    adversary = SVM(1, seed=0)
    adversary.train(oracle)
    assert adversary._classes.tolist() == [0, 1, 2, 3, 4]
    assert np.bincount(np.digitize(score, svm._EDGES)).tolist() == [20, 20, 20, 20, 21]


def test_cross_validation_chooses_the_width_that_generalises():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.7, 1.7, (400, 2))
    fold = np.arange(400) % 3
    stripes = (np.floor(2.0 * x[:, 0]) % 2).astype(int)
    halves = (x[:, 0] > 0).astype(int)
    assert svm._cross_validate(x, stripes, fold)[1] > svm._cross_validate(x, halves, fold)[1]


@pytest.mark.parametrize("score", [0.0, 0.25, 1.0])
def test_a_single_class_gives_uniform_samples(score, tmp_path):
    adversary = trained(lambda mu: np.full(len(mu), score))
    fooling = [] if score <= 0.3 else [NONE_FOOLED_BUT_ALL_LEARNT]
    assert adversary.flags == [*fooling, ONE_CLASS]
    adversary.save(tmp_path)
    samples = SVM.load(tmp_path).sample(1000)
    assert abs(samples.std() - 3**-0.5) < 0.03


@pytest.mark.parametrize("rare", [1, 2])
@pytest.mark.parametrize("dimension", [1, 64])
def test_a_class_of_fewer_members_than_folds(rare, dimension):
    scores = np.concatenate([np.zeros(rare), np.full(60, 0.9)])
    adversary = trained(lambda mu: scores[: len(mu)], budget=len(scores), dimension=dimension)
    assert adversary._classes.tolist() == [0, 4]
    assert adversary.sample(20).shape == (20, dimension)


def test_finds_a_rare_class():
    """One point in fifty fools; equal weights would hardly predict it."""
    adversary = trained(lambda mu: np.where((mu > 0.72).all(axis=1), 0.0, 0.9), budget=1000)
    assert (adversary.sample(10) > 0.6).all()


@pytest.mark.parametrize("dimension", [2, 5])
def test_beats_uniform_on_four_regions(dimension):
    application = AnalyticApplication(dimension=dimension)
    adversary = SVM(dimension, seed=0)
    adversary.train(RecordingOracle(application, budget=1000))
    region = application.fooling_region(adversary.sample(250))
    assert (region >= 0).mean() > 0.2
    assert set(region) == {-1, 0, 1, 2, 3}


def test_beats_uniform_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = SVM(8, seed=0, subset=500)
    adversary.train(FunctionOracle(landscape, 1000))
    assert landscape.fooling_rate(adversary.sample(250)).mean() > 0.35 + 0.2


def test_nan_is_refused():
    with pytest.raises(ValueError, match="Expected 300 finite scores"):
        trained(lambda mu: np.full(len(mu), np.nan))
