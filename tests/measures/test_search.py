import numpy as np
import pytest

from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.measures.coverage import density_and_coverage, expected_coverage
from sada_gym.measures.search import anytime

THRESHOLD = 0.3


def searched(n=3_000, seed=0):
    rng = np.random.default_rng(seed)
    application = AnalyticApplication(dimension=3, volume=0.1)
    queries = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
    scores = application.evaluate(queries, [0] * n).score
    return queries, scores, application.sample_fooling_set(800, rng)


def test_the_curve_is_what_each_stage_gives_by_itself():
    queries, scores, fooling_set = searched()
    points = anytime(queries, scores, THRESHOLD, fooling_set, [1, 100, 3_000])
    for point, n in zip(points, (1, 100, 3_000), strict=True):
        fooling = queries[:n][scores[:n] <= THRESHOLD]
        assert (point.queries, point.found) == (n, len(fooling))
        assert point.share == len(fooling) / n
        assert point.coverage == density_and_coverage(fooling_set, fooling).coverage
    assert points[0].coverage == 0.0
    assert 0.02 < points[1].coverage < points[2].coverage
    expected = expected_coverage(800, points[2].found)
    assert points[2].coverage == pytest.approx(expected, abs=0.05)


def test_a_search_in_one_place_covers_little_however_often_it_fools():
    queries, scores, fooling_set = searched()
    wide = anytime(queries, scores, THRESHOLD, fooling_set, [3_000])[0]
    cluster = fooling_set[0] + 0.005 * np.random.default_rng(1).normal(size=(3_000, 3))
    narrow = anytime(cluster, np.zeros(3_000), THRESHOLD, fooling_set, [3_000])[0]
    assert narrow.share == 1.0 > wide.share
    assert narrow.found == 3_000 > wide.found
    assert narrow.coverage < 0.1 < 0.5 < wide.coverage


def test_asking_again_finds_nothing():
    mu = [[0.0, 0.5], [-0.0, 0.5], [0.1, 0.5], [0.0, 0.5]]
    points = anytime(mu, [0.2, 0.2, 0.9, 0.2], THRESHOLD, None, [1, 2, 3, 4])
    assert [point.found for point in points] == [1, 1, 1, 1]
    assert [point.share for point in points] == [1.0, 1.0, 2 / 3, 0.75]
    assert {point.coverage for point in points} == {None}


def test_nothing_found():
    point = anytime(np.zeros((4, 2)), np.ones(4), THRESHOLD, np.eye(8)[:, :2], [4])[0]
    assert (point.found, point.share, point.coverage) == (0, 0.0, 0.0)


@pytest.mark.parametrize("checkpoints", [[], [0, 2], [2, 2], [3, 2], [2, 5]])
def test_bad_checkpoints_are_refused(checkpoints):
    with pytest.raises(ValueError, match="increasing checkpoints from 1 to 4"):
        anytime(np.zeros((4, 2)), np.ones(4), THRESHOLD, None, checkpoints)


def test_bad_queries_are_refused():
    with pytest.raises(ValueError, match=r"got \(4, 2\) and \(3,\)"):
        anytime(np.zeros((4, 2)), np.ones(3), THRESHOLD, None, [1])
    with pytest.raises(ValueError, match="finite scores"):
        anytime(np.zeros((4, 2)), [0, 0, 0, np.nan], THRESHOLD, None, [1])
