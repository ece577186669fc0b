import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sada_gym.adversaries.rl import failure_rewards, novelties
from sada_gym.evaluations import Evaluations


def queries(scores, mu=None):
    mu = np.zeros((len(scores), 2)) if mu is None else np.asarray(mu)
    return Evaluations.unseeded(mu.astype(np.float32), np.asarray(scores, float))


def rewards(asked, seen, rank=0.5, dissimilarity=0.0):
    return failure_rewards(asked, seen, 0.3, rank=rank, dissimilarity=dissimilarity)


def test_failures_are_paid_one_and_others_by_their_rank_among_all_misses():
    asked, seen = queries([0.1, 0.3, 0.4, 0.9]), queries([0.5, 0.6, 0.0])
    # misses: 0.4, 0.5, 0.6, 0.9; each counts itself as half above
    assert_allclose(rewards(asked, seen), [1.0, 1.0, 0.5 * 3.5 / 4, 0.5 * 0.5 / 4])


def test_equal_scores_are_paid_the_same():
    assert_allclose(rewards(queries([0.8] * 5), queries([])), 0.25)


@pytest.mark.parametrize("transform", [lambda q: q**4, np.log, lambda q: q - 1e6])
def test_scores_count_by_their_order(transform):
    rng = np.random.default_rng(0)
    scores, mu = rng.uniform(0.1, 1.0, 60), rng.uniform(-1.0, 1.0, (60, 2))

    def paid(change):
        asked, seen = queries(change(scores[40:]), mu[40:]), queries(change(scores[:40]), mu[:40])
        return failure_rewards(
            asked, seen, float(change(np.array(0.3))), rank=0.5, dissimilarity=0.5
        )

    assert_array_equal(paid(transform), paid(lambda q: q))


def test_only_failures_are_paid_for_being_new():
    seen = queries([0.0] * 3 + [0.9], [[0, 0], [0.1, 0], [0.2, 0], [1, 1]])
    asked = queries([0.0, 0.0, 0.9], [[0.1, 0.001], [-1, -1], [-1, -1]])
    known, new, missed = rewards(asked, seen, dissimilarity=2.0)
    assert (known, new) == (1.0, 3.0)
    assert missed == rewards(asked, seen)[2]


def test_novelty_compares_with_the_failures_own_distances():
    failures = np.float32([[0, 0], [0.1, 0], [0.3, 0], [0.6, 0]])  # 0.1, 0.1, 0.2, 0.3
    mu = np.float32([[0.05, 0], [0.3, 0.15], [0.6, 0.25], [0.6, 0.9]])
    assert_allclose(novelties(mu, failures), [0.0, 0.5, 0.75, 1.0])
    # the same at any scale
    assert_allclose(novelties(0.01 * mu, 0.01 * failures), [0.0, 0.5, 0.75, 1.0])


@pytest.mark.parametrize("count", [0, 1])
def test_everything_is_new_where_hardly_anything_is_known(count):
    assert_array_equal(novelties(np.zeros((3, 2), np.float32), np.zeros((count, 2))), 1.0)


def test_failures_that_are_all_equal_make_everything_else_new():
    failures = np.zeros((5, 2), np.float32)
    assert_array_equal(novelties(np.float32([[0, 0], [0, 0.1]]), failures), [0.0, 1.0])
