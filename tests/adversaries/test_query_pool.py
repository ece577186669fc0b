import numpy as np
import pytest

from sada_gym.adversaries.query_pool import FALLBACK_SIZE, evaluate_uniform, select_fooling
from sada_gym.evaluations import Evaluations
from studies.landscapes import FunctionOracle


def pool(scores):
    scores = np.asarray(scores, dtype=np.float64)
    return Evaluations.unseeded(
        np.arange(len(scores), dtype=np.float32)[:, None] / len(scores), scores
    )


def test_the_lowest_that_fool_are_induced_and_the_rest_does_not_fool():
    queries = pool([0.9, 0.1, 0.3, 0.31, 0.0])
    induced = select_fooling(queries, 0.3, np.random.default_rng(0))
    assert sorted(induced.chosen[:, 0] * 5) == pytest.approx([1, 2, 4])
    assert sorted(induced.rest[:, 0] * 5) == pytest.approx([0, 3])
    assert not induced.fallback


def test_a_size_limits_the_set_but_no_fooling_point_joins_the_rest():
    induced = select_fooling(
        pool([0.9, 0.1, 0.3, 0.31, 0.0]), 0.3, np.random.default_rng(0), size=2
    )
    assert sorted(induced.chosen[:, 0] * 5) == pytest.approx([1, 4])
    assert sorted(induced.rest[:, 0] * 5) == pytest.approx([0, 3])


def test_the_seed_breaks_ties():
    queries = pool(np.zeros(1000))
    first, again, other = (
        select_fooling(queries, 0.3, np.random.default_rng(seed), size=100).chosen
        for seed in (0, 0, 1)
    )
    assert (first == again).all()
    assert (first != other).any()
    assert 0.4 < first.mean() < 0.6  # not simply the first ones evaluated


def test_where_none_fools_the_lowest_are_taken_and_flagged():
    induced = select_fooling(pool(np.linspace(0.4, 1.0, 500)), 0.3, np.random.default_rng(0))
    assert induced.fallback
    assert len(induced.chosen) == FALLBACK_SIZE
    assert induced.chosen.max() < induced.rest.min()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_scores_that_are_no_numbers_are_refused(bad):
    oracle = FunctionOracle(lambda mu: np.full(len(mu), bad), 10)
    with pytest.raises(ValueError, match=r"Expected 10 finite scores, got shape .* with 10 NaN"):
        evaluate_uniform(10, 2, oracle, np.random.default_rng(0))


def test_no_budget_is_refused():
    oracle = FunctionOracle(lambda mu: np.zeros(len(mu)), 0)
    with pytest.raises(ValueError, match="Expected a budget of at least 1 query"):
        evaluate_uniform(0, 2, oracle, np.random.default_rng(0))
