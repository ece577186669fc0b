import numpy as np
import pytest

from sada_gym.adversaries.selection import NONE_FOOLED_BUT_ALL_LEARNT, Selection
from studies.landscapes import FunctionOracle


class First(Selection):
    """Predicts the first coordinate, rounded down to steps; keeps the pools it was shown."""

    name = "first"
    steps = 10**9

    def fit(self, queries):
        self.pools = []

    def _predict(self, mu):
        self.pools.append(mu)
        return np.floor(mu[:, 0] * self.steps)

    def arrays(self):
        return {}

    def restore(self, arrays):
        pass


def trained(budget=1000, score=0.0, **options):
    adversary = First(2, seed=0, **options)
    adversary.train(FunctionOracle(lambda mu: np.full(len(mu), score), budget))
    return adversary


def test_samples_are_the_lowest_of_a_pool_as_large_as_omega():
    adversary = trained()
    samples = adversary.sample(50)
    (pool,) = adversary.pools
    assert pool.shape == (1000, 2)
    assert np.abs(pool.mean()) < 0.05
    lowest = pool[np.argsort(pool[:, 0])[:50]].astype(np.float32)
    assert (np.unique(samples, axis=0) == np.unique(lowest, axis=0)).all()


def test_samples_come_in_no_order():
    first = trained().sample(200)[:, 0]
    assert abs(np.corrcoef(first, np.arange(200))[0, 1]) < 0.2


@pytest.mark.parametrize(("pool", "n", "size"), [(None, 400, 1600), (5000, 10, 5000), (30, 10, 40)])
def test_the_size_of_the_pool(pool, n, size):
    adversary = trained(pool=pool)
    adversary.sample(n)
    assert len(adversary.pools[0]) == size


def test_every_call_draws_a_pool_of_its_own():
    adversary = trained()
    adversary.sample(5)
    adversary.sample(5)
    assert not np.isin(adversary.pools[0], adversary.pools[1]).any()


def test_ties_are_broken_by_the_seed():
    adversary = trained()
    adversary.steps = 0
    samples = adversary.sample(250)
    assert np.abs(samples.mean(axis=0)).max() < 0.15
    assert samples.std() > 0.5


def test_no_fooling_point_is_flagged():
    assert trained(score=0.31).flags == [NONE_FOOLED_BUT_ALL_LEARNT]
    assert trained(score=0.3).flags == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pool": 0}, r"Expected pool to be an int from 1 to 1,000,000, or None; got 0\."),
        ({"pool": 1e3}, r"Expected pool to be an int from 1 to 1,000,000, or None; got 1000\.0"),
        ({"subset": 9}, r"Expected subset to be an int from 10 to 10,000, such as 2000; got 9\."),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        First(2, **options)
