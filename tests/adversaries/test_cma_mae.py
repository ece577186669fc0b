import subprocess
import sys

import numpy as np
import pytest

from sada_gym.adversaries.cma_mae import CMAMAE
from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.evaluations import Evaluations
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape

pytest.importorskip("ribs")


class TestCMAMAE(AdversaryContract):
    def make(self, dimension, seed):
        return CMAMAE(dimension, seed=seed)

    def test_spends_the_budget_and_starts_with_uniform_points(self):
        adversary, oracle = self.train()
        assert oracle.remaining == 0
        assert (adversary.queries.mu == oracle.queries).all()
        uniform = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2)).astype(np.float32)
        assert (oracle.queries[:40] == uniform).all()
        later = adversary.queries.score[40:].mean()
        assert later < adversary.queries.score[:40].mean() - 0.1


def trained(score, budget=200, dimension=2, **options):
    adversary = CMAMAE(dimension, seed=0, **options)
    adversary.train(FunctionOracle(score, budget))
    return adversary


@pytest.mark.parametrize("dimension", [2, 5, 8])
def test_covers_four_regions(dimension):
    application = AnalyticApplication(dimension=dimension)
    adversary = CMAMAE(dimension, seed=0)
    adversary.train(RecordingOracle(application, budget=2000))
    region = application.fooling_region(adversary.sample(500))
    assert (region >= 0).mean() > 0.75
    assert (np.bincount(region[region >= 0], minlength=4) > 15).all()


def test_leads_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = trained(landscape, 2000, 8)
    assert landscape.fooling_rate(adversary.sample(500)).mean() > 0.35 + 0.35


def test_luck_fades():
    """Everywhere a point may fool, but on one side thirty times as often."""
    rng = np.random.default_rng(0)
    mu, centroids = rng.uniform(-1.0, 1.0, (2000, 2)), rng.uniform(-1.0, 1.0, (50, 2))
    fools = rng.uniform(size=2000) < np.where(mu[:, 0] > 0.0, 0.9, 0.03)
    adversary = CMAMAE(2, seed=0)
    adversary.threshold, adversary._centroids = 0.3, centroids
    adversary.fit(Evaluations.unseeded(mu.astype(np.float32), np.where(fools, 0.0, 0.6)))
    lucky = adversary._points[:, 0] < -0.2
    assert lucky.mean() > 0.02
    assert adversary._odds[lucky].sum() < 0.4 * lucky.mean()


@pytest.mark.parametrize("score", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("dimension", [1, 64])
def test_constant_scores(score, dimension):
    adversary = trained(lambda mu: np.full(len(mu), score), 300, dimension)
    assert adversary.flags == ([] if score == 0.0 else [NONE_FOOLED])
    samples = adversary.sample(500)
    assert len(np.unique(samples, axis=0)) == 500


def test_no_fooling_point_still_leads_to_the_lowest():
    adversary = trained(lambda mu: 0.5 + 0.4 * np.abs(mu - 0.5).max(axis=1) / 1.5, 1000)
    assert adversary.flags == [NONE_FOOLED]
    assert np.abs(adversary.sample(100) - 0.5).max() < 0.5


@pytest.mark.parametrize("budget", [1, 40])
def test_a_single_fooling_point_is_left_for_its_surroundings(budget):
    first = iter([True])

    def score(mu):
        return np.where((np.arange(len(mu)) == 0) & next(first, False), 0.0, 0.9)

    adversary = trained(score, budget)
    assert adversary.flags == []
    samples = adversary.sample(200)
    assert len(np.unique(samples, axis=0)) == 200
    assert 0.01 < np.abs(samples - adversary.queries.mu[0]).max() < 1.5


def test_nan_is_refused():
    with pytest.raises(ValueError, match="Expected 40 finite scores"):
        trained(lambda mu: np.full(len(mu), np.nan))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cells": 0}, "Expected cells to be an int from 1 to 100,000, such as 100; got 0"),
        ({"cells": 10**9}, "Expected cells to be an int from 1 to 100,000"),
        ({"emitters": 1.5}, r"Expected emitters to be an int from 1 to .*; got 1\.5"),
        ({"uniform_share": 1.0}, "uniform_share to be a float between 0 and 1, both excluded"),
        ({"sigma": float("nan")}, "Expected sigma to be a float between 0 and 1, .*; got nan"),
        ({"learning_rate": -0.1}, r"Expected learning_rate to be a float from 0 to 1, .*got -0\.1"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        CMAMAE(2, **options)


def test_missing_ribs_is_named_with_its_remedy_before_any_query(monkeypatch):
    monkeypatch.setitem(sys.modules, "ribs", None)
    oracle = RecordingOracle(AnalyticApplication(), budget=50)
    with pytest.raises(ModuleNotFoundError, match=r"pip install .* '\.\[qd\]'"):
        CMAMAE(2, seed=0).train(oracle)
    assert oracle.remaining == 50


@pytest.mark.long
def test_ribs_is_imported_only_to_train():
    code = "import sys; from sada_gym.adversaries.cma_mae import CMAMAE; CMAMAE(2);"
    code += "sys.exit('ribs' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
