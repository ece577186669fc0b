import numpy as np
import pytest

from sada_gym.analyses.plots.failure_choice import choose_failures, features
from sada_gym.oracle import Evaluations
from sada_gym.parameters import Parameter, ParameterSpace

PLANE = ParameterSpace(Parameter("x", -1, 1), Parameter("y", -1, 1))


def evaluated(mu, score):
    return Evaluations(np.array(mu, np.float32), np.array(score, float), np.arange(len(score)))


def rows(failures):
    return [failure.sample for failure in failures]


def random_failures(n, seed=0):
    rng = np.random.default_rng(seed)
    return evaluated(rng.uniform(-1, 1, (n, 2)), rng.random(n))


def test_the_worst_have_the_lowest_scores_and_nobody_is_shown_twice():
    samples = random_failures(200)
    chosen = choose_failures(PLANE, samples, 0.6, (4, 4, 4))
    assert rows(chosen.worst) == np.argsort(samples.score)[:4].tolist()
    shown = rows(chosen.shown)
    assert len(set(shown)) == len(shown) == 12
    assert (samples.score[shown] <= 0.6).all()


def test_of_equally_bad_ones_the_most_typical_comes_first():
    cross = [[0.4, 0], [-0.4, 0], [0, 0], [0, 0.4], [0, -0.4], [0.1, 0.1]]
    samples = evaluated(cross, [0, 0, 0, 0, 0, 0.1])
    assert rows(choose_failures(PLANE, samples, 0.3, (1, 0, 0)).worst) == [2]


def test_typical_ones_are_the_centres_of_clusters_and_say_how_large_these_are():
    rng = np.random.default_rng(0)
    centres = np.repeat([[-0.7, -0.7], [0.7, 0.7]], [30, 10], axis=0)
    samples = evaluated(centres + rng.normal(0, 0.1, (40, 2)), np.full(40, 0.1))
    chosen = choose_failures(PLANE, samples, 0.3, (0, 2, 0))
    np.testing.assert_allclose(samples.mu[rows(chosen.typical)], centres[[0, 39]], atol=0.12)
    assert [failure.stands_for for failure in chosen.typical] == [0.75, 0.25]


def test_diverse_ones_lie_where_nothing_is_shown_yet():
    crowd = np.random.default_rng(0).normal(0, 0.05, (50, 2))
    corners = [[1, 1], [-1, 1], [1, -1], [-1, -1]]
    samples = evaluated([*crowd, *corners], [0.0] * 50 + [0.2] * 4)
    chosen = choose_failures(PLANE, samples, 0.3, (2, 1, 4))
    assert sorted(rows(chosen.diverse)) == [50, 51, 52, 53]


def test_of_samples_that_are_alike_the_worst_is_shown():
    samples = evaluated([[0, 0], [0.01, 0], [0, 0.015], [0.5, 0.5]], [0.2, 0.1, 0.2, 0.3])
    chosen = choose_failures(PLANE, samples, 0.3, (4, 4, 4))
    assert [(f.sample, f.alike) for f in chosen.shown] == [(1, 2), (3, 0)]


def test_a_collapsed_adversary_has_one_failure():
    samples = evaluated(np.zeros((100, 2)), np.zeros(100))
    (only,) = choose_failures(PLANE, samples, 0.3, (3, 3, 3)).shown
    assert only.alike == 99


def test_without_failures_there_is_nothing_to_show():
    assert choose_failures(PLANE, evaluated([[0, 0]], [0.9]), 0.3, (1, 1, 1)).shown == ()


@pytest.mark.parametrize("n", [1, 2, 5, 3_000])
def test_any_number_of_failures(n):
    chosen = choose_failures(PLANE, random_failures(n), 1.0, (2, 2, 4))
    assert len(chosen.shown) == min(n, 8)
    assert chosen == choose_failures(PLANE, random_failures(n), 1.0, (2, 2, 4))


def test_choices_are_alike_or_all_as_far_apart():
    space = ParameterSpace(Parameter("weather", 0, 3, choices=("sun", "rain", "snow")))
    places = features(space, np.array([[-1], [-0.5], [0], [0.9], [1]], np.float32))
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    np.testing.assert_allclose(apart[0], [0, 0, 1, 1, 1])
    np.testing.assert_allclose(apart[2], [1, 1, 0, 1, 1])
