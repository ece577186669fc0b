"""Ask and tell: what a caller that owns the loop may do, and what is refused."""

import numpy as np
import pytest

from sada_gym import adversaries
from sada_gym.adversaries.base import Adversary
from sada_gym.errors import UserError


class Twice(Adversary):
    """Asks four worlds, and four more around the best of them."""

    name = "twice"

    def train(self, oracle):
        first = self.rng.uniform(-1, 1, (4, self.dimension)).astype(np.float32)
        scores = oracle(first)
        self.best = first[scores.argmin()]
        if oracle.remaining:
            oracle(np.clip(self.best + np.zeros((oracle.remaining, 1), np.float32), -1, 1))
        self.seen = scores

    def sample(self, n):
        return np.repeat(self.best[None], n, axis=0)

    def save(self, folder):
        raise NotImplementedError

    @classmethod
    def load(cls, folder):
        raise NotImplementedError


@pytest.fixture
def twice():
    adversary = Twice(2, seed=0)
    adversary.start(8, threshold=0.3)
    return adversary


def test_scores_come_in_any_order_and_number(twice):
    mu = np.concatenate([twice.ask(3), twice.ask(9)])
    assert len(mu) == 4
    assert not len(np.intersect1d(mu[0], mu[1]))
    scores = np.array([0.4, 0.1, 0.3, 0.2])
    for rows in ([3], [1, 0], [2]):
        twice.tell(mu[rows], scores[rows])
    same = twice.ask(10)  # one world four times
    assert (same == mu[1]).all()
    twice.tell(same[:1], [0.5])
    twice.tell(same[1:], [0.5, 0.5, 0.5])
    assert twice.ask(1).shape == (0, 2)
    assert twice.ask(1).shape == (0, 2)
    assert twice.seen.tolist() == scores.tolist()
    assert (twice.sample(2) == mu[1]).all()


def test_what_is_not_asked_or_no_score_is_refused(twice):
    mu = twice.ask(4)
    with pytest.raises(UserError, match=r"the scores of 4 queries before more are asked for"):
        twice.ask(1)
    with pytest.raises(UserError, match=r"Expected mu as ask returned it"):
        twice.tell(-mu, np.zeros(4))
    for wrong in ([0.1], [0.1, np.nan, 0.1, 0.1], "abcd"):
        with pytest.raises(UserError):
            twice.tell(mu, wrong)
    twice.tell(mu[:1], [0.1])
    with pytest.raises(UserError, match=r"whose score is known"):
        twice.tell(mu[:1], [0.1])


def test_nothing_started_is_refused_and_a_second_start_ends_the_first(twice):
    with pytest.raises(UserError, match=r"Call start\(budget"):
        Twice(2).ask(1)
    twice.ask(2)
    thread = twice._dialogue._thread
    twice.start(8, threshold=0.3)
    thread.join(10)
    assert not thread.is_alive()
    assert len(twice.ask(4)) == 4


def test_what_training_raises_is_raised_where_it_is_asked():
    adversary = adversaries.make("gmm10", dimension=2, seed=0)
    adversary.start(0, threshold=0.3)
    with pytest.raises(ValueError, match="budget"):
        adversary.ask(5)
    assert len(adversary.ask(5)) == 0
