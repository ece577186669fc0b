import tracemalloc

import numpy as np
import pytest

from sada_gym.adversaries.models.hits import Hits, between, in_turn


def test_a_query_close_to_an_earlier_hit_checks_it():
    mu = np.array([[0.0], [0.5], [0.05], [0.06], [-0.8]])
    fooled = np.array([True, False, False, True, True])
    hits = Hits(mu, fooled, np.array([0.2, 0.9, 0.9, 0.9, 0.5]), radius=0.1)
    assert hits.mu[:, 0].tolist() == [0.0, -0.8]
    # the prediction, the hit itself, and two checks of which one fooled; then no check
    assert hits.chance == pytest.approx([(0.2 + 2) / 4, (0.5 + 1) / 2])


def test_checks_go_where_a_hit_is_most_in_doubt_and_each_is_counted():
    hits = Hits(np.array([[-0.5], [0.5]]), np.ones(2, bool), np.array([0.1, 0.5]), radius=0.1)
    assert hits.most_in_doubt(1)[:, 0].tolist() == [-0.5]
    assert sorted(hits.most_in_doubt(3)[:, 0]) == [-0.5, -0.5, 0.5]
    assert len(hits.most_in_doubt(100)) == 4
    assert hits.most_in_doubt(0).shape == (0, 1)


def test_hits_whose_checks_fail_are_not_kept():
    centres = np.linspace(-1.0, 1.0, 20)[:, None]
    checks = np.repeat(centres, 2, axis=0) + 1e-4
    lasting = np.arange(20) < 10  # the others fooled by luck, and never again
    mu = np.concatenate([centres, checks])
    fooled = np.concatenate([np.ones(20, bool), np.repeat(lasting, 2)])
    hits = Hits(mu, fooled, np.full(60, 0.3), radius=1e-3)
    assert (hits.kept(0.45) == centres[:10]).all()


def test_a_large_radius_needs_little_memory():
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (3_000, 2))
    tracemalloc.start()
    hits = Hits(mu, np.ones(3_000, bool), np.ones(3_000), radius=3.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(hits.mu) == 1
    assert peak < 10 * 2**20  # all pairs would take 70 MiB at least


def test_where_nothing_fooled_there_are_no_hits():
    hits = Hits(np.zeros((5, 3)), np.zeros(5, bool), np.zeros(5), radius=0.1)
    assert hits.kept(0.0).shape == hits.most_in_doubt(7).shape == (0, 3)


def test_a_query_between_two_hits_lies_on_the_way_from_one_to_a_near_one():
    rng = np.random.default_rng(0)
    hits = np.array([[x, y] for x in (-0.9, 0.9) for y in (0.0, 0.1, 0.2, 0.3)])
    mu = between(hits, 40, rng)
    assert mu.shape == (40, 2)
    assert np.abs(mu[:, 0]) == pytest.approx(0.9)  # never from one group to the other
    assert np.ptp(mu[:, 1]) <= 0.3
    assert (np.abs(mu[:, 1, None] - hits[:, 1]).min(axis=1) > 1e-3).all()
    assert between(hits, 0, rng).shape == (0, 2)


@pytest.mark.parametrize("count", [0, 2, 7])
def test_hits_come_in_turn(count):
    chosen = in_turn(count, 3, np.random.default_rng(0))
    assert len(chosen) == count
    assert np.ptp(np.bincount(chosen, minlength=3)) <= 1
