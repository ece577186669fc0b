import numpy as np
import pytest

from sada_gym.board.results.figures import Figure, figure, ranks_of
from sada_gym.measures.statistics import estimate


def test_equal_seeds_are_bootstrapped():
    runs = [[0.2, 0.4], [0.6, 0.5]]
    whole = estimate(runs, samples=10)
    assert figure(runs, [10, 10]) == Figure(value=whole.value, interval_95=whole.interval)
    assert figure([[0.25], [0.75]]) == Figure(value=0.5, interval_95=None)


def test_a_track_counts_once_however_many_seeds_it_has():
    for samples in (None, [10, 10]):
        mean = figure([[0.0, 0.2, 0.4], [0.8]], samples)
        assert mean.value == pytest.approx(0.5)
        assert mean.interval_95[0] < 0.5 < mean.interval_95[1]


def test_a_rate_of_all_or_nothing_stays_within_its_range():
    low, high = figure([[1.0, 1.0, 1.0], [1.0]], [250, 250]).interval_95
    assert 0.98 < low < 1.0 == high
    low, high = figure([[0.0, 0.0, 0.0], [0.0]], [250, 250]).interval_95
    assert low == 0.0 < high < 0.02


@pytest.mark.parametrize("is_rate", [True, False])
def test_the_intervals_of_unequal_seeds_hold_the_truth(is_rate):
    rng, truth, hits = np.random.default_rng(0), np.array([0.2, 0.5, 0.7, 0.9]), 0
    for _ in range(60):
        if is_rate:
            runs = [rng.binomial(50, p, 3 if i < 2 else 1) / 50 for i, p in enumerate(truth)]
            mean = figure([list(r) for r in runs], [50] * 4)
        else:
            runs = [rng.normal(p, 0.05, 3 if i < 2 else 1) for i, p in enumerate(truth)]
            mean = figure([list(r) for r in runs])
        hits += mean.interval_95[0] <= truth.mean() <= mean.interval_95[1]
    assert hits >= 52


def test_ranks_are_shared_and_controls_have_none():
    figures = {
        "best": Figure(value=0.9, interval_95=(0.85, 0.95)),
        "second": Figure(value=0.5, interval_95=(0.4, 0.6)),
        "third": Figure(value=0.45, interval_95=(0.4, 0.5)),
        "control": Figure(value=1.0, interval_95=(0.99, 1.0)),
    }
    ranks = ranks_of(figures, ["control"])
    assert ranks == {"best": "1", "second": "2=", "third": "2="}
    blind = {"a": Figure(value=0.9, interval_95=None), "b": Figure(value=0.1, interval_95=None)}
    assert ranks_of(blind, []) == {}
