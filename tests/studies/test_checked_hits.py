import numpy as np
import pytest

from sada_gym.adversaries.level_set import LevelSet
from sada_gym.evaluations import Evaluations
from studies.checked_hits import CheckedHits, Hits
from studies.landscapes import FunctionOracle
from studies.lucky_landscapes import LuckyLandscape


def test_a_query_close_to_an_earlier_hit_checks_it():
    mu = np.array([[0.0], [0.5], [0.05], [0.06], [-0.8]])
    fooled = np.array([True, False, False, True, True])
    hits = Hits(mu, fooled, np.array([0.2, 0.9, 0.9, 0.9, 0.5]), radius=0.1)
    assert hits.mu[:, 0].tolist() == [0.0, -0.8]
    # the prediction, the hit itself, and two checks of which one fooled; then no check
    assert hits.chance == pytest.approx([(0.2 + 2) / 4, (0.5 + 1) / 2])


def test_checks_go_where_a_hit_is_most_in_doubt_and_each_is_counted():
    hits = Hits(np.array([[-0.5], [0.5]]), np.ones(2, bool), np.array([0.1, 0.5]), radius=0.1)
    assert hits.to_check(1).tolist() == [0]
    assert sorted(hits.to_check(3).tolist()) == [0, 0, 1]
    assert len(hits.to_check(100)) == 4


def test_hits_whose_checks_fail_are_not_kept():
    centres = np.linspace(-1.0, 1.0, 20)[:, None]
    checks = np.repeat(centres, 2, axis=0) + 1e-4
    lasting = np.arange(20) < 10  # the others fooled by luck, and never again
    mu = np.concatenate([centres, checks])
    fooled = np.concatenate([np.ones(20, bool), np.repeat(lasting, 2)])
    hits = Hits(mu, fooled, np.full(60, 0.3), radius=1e-3)
    assert hits.checks == 40
    assert (hits.kept(0.45) == centres[:10]).all()


def test_a_check_between_two_hits_lies_on_the_way_from_one_to_a_near_one():
    adversary = CheckedHits(2, seed=0)
    hits = np.array([[x, y] for x in (-0.9, 0.9) for y in (0.0, 0.1, 0.2, 0.3)])
    between = adversary._between(hits, 40)
    assert between.shape == (40, 2)
    assert np.abs(between[:, 0]) == pytest.approx(0.9)  # never from one group to the other
    assert np.ptp(between[:, 1]) <= 0.3
    assert (np.abs(between[:, 1, None] - hits[:, 1]).min(axis=1) > 1e-3).all()
    assert adversary._between(hits, 0).shape == (0, 2)


def train(adversary, landscape):
    adversary.train(FunctionOracle(landscape, 400))
    return landscape.fooling_rate(adversary.sample(200)).mean()


@pytest.mark.slow
def test_it_fools_more_often_where_luck_hides_many_spots():
    rates = [
        train(
            make(5, seed=0, rounds=2, models=["process"]),
            LuckyLandscape(0, shape="spots", dimension=5),
        )
        for make in (LevelSet, CheckedHits)
    ]
    assert rates[1] > rates[0] + 0.1


def learnt(score, **options):
    adversary = CheckedHits(2, seed=0, rounds=2, models=["process"], **options)
    adversary.train(FunctionOracle(score, 300))
    return adversary


def test_where_the_level_set_is_sure_it_alone_is_sampled():
    assert not len(learnt(lambda mu: (mu[:, 0] + 1.0) / 2.0)._centres)


def test_the_parts_of_the_samples_beside_hits_and_in_the_level_set_are_as_asked():
    luck = LuckyLandscape(0, shape="smooth", dimension=2, inside=0.7, volume=0.4)
    adversary = learnt(luck, sure=1.0, pays=0.0, beside=0.7, keep=0.7)
    assert adversary._part == 0.7
    samples = adversary._draw(2_000)
    distances = np.linalg.norm(samples[:, None] - adversary._centres[None], axis=2).min(axis=1)
    level = np.linalg.norm(
        LevelSet._draw(adversary, 2_000)[:, None] - adversary._centres[None], axis=2
    ).min(axis=1)
    far = distances > 4 * adversary.options.width  # which hardly any step from a hit is
    assert far.mean() == pytest.approx(0.3 * (level > 4 * adversary.options.width).mean(), abs=0.03)
    assert far.mean() > 0.05
    assert abs(far[:1_000].mean() - far[1_000:].mean()) < 0.05  # in any order


class Surrogate:
    """Says that mu fool with chance 0.8, but with 0.6 where x > 0."""

    raised = False

    def __init__(self, queries):
        self.held_out = np.full(queries, 0.8)

    def __call__(self, mu):
        return np.where(mu[:, 0] > 0.0, 0.6, 0.8)


def asked(checks):
    """Twenty hits where x > 0, each checked so often."""
    y = np.linspace(-0.95, 0.95, 20)
    mu = np.stack([np.full(20, 0.5), y], axis=1).astype(np.float32)
    return Evaluations.unseeded(np.concatenate([mu] * (1 + checks)), np.zeros(20 * (1 + checks)))


@pytest.mark.parametrize(("pays", "checks"), [(1.0, 0), (0.9, 30)])
def test_checks_end_where_they_are_predicted_to_fool_too_seldom(pays, checks):
    """The level set fools with 0.7, mu beside hits with 0.6; checks need 0.9 x pays of 0.7."""
    adversary = CheckedHits(2, seed=0, pays=pays, width=0.01)
    adversary.threshold = 0.3
    pool = np.stack([np.linspace(-1.0, 1.0, 1_000), np.zeros(1_000)], axis=1).astype(np.float32)
    assert len(adversary._checks(asked(2), Surrogate(60), pool, 101)) == checks


def test_a_trial_of_thirty_checks_comes_first():
    adversary = CheckedHits(2, seed=0, pays=1.0, width=0.01)
    adversary.threshold = 0.3
    assert len(adversary._checks(asked(0), Surrogate(20), adversary._uniform(1_000), 150)) == 30


@pytest.mark.parametrize("shape", ["smooth", "spots"])
def test_the_landscape_fools_as_often_as_it_says(shape):
    landscape = LuckyLandscape(1, shape=shape, dimension=3, inside=0.7, outside=0.1)
    mu = np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3))
    rate = landscape.fooling_rate(mu)
    assert set(rate) == {0.1, 0.7}
    assert (rate == 0.7).mean() == pytest.approx(0.15, abs=0.05)
    assert (landscape(mu) <= 0.3).mean() == pytest.approx(rate.mean(), abs=0.01)
