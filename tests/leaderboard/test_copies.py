import numpy as np
import pytest

from sada_gym.board.submission.flags import is_near, nearness
from sada_gym.measures.reference import reference_mu
from studies.copied_points import spacing

DIMENSIONS = (3, 6, 8, 10)


def points_of(dimension):
    return reference_mu(dimension, 4_000, 0)


@pytest.mark.parametrize("width", [1.0, 0.75, 0.5, 0.25])
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_honest_samples_are_no_copies_wherever_they_lie(dimension, width):
    rng = np.random.default_rng(7)
    for _ in range(3):
        mu = rng.uniform(-width, width, (300, dimension)).astype(np.float32)
        near = nearness(mu, points_of(dimension))
        assert not is_near(near)
        assert near.p > 1e-3
        assert near.exact == 0


def test_samples_at_the_corners_are_no_copies():
    rng = np.random.default_rng(7)
    mu = np.sign(rng.uniform(-1, 1, (300, 10))).astype(np.float32)
    assert not is_near(nearness(mu, points_of(10)))


@pytest.mark.parametrize("jitter", [0.1, 0.25, 0.5])
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_points_with_jitter_are_copies(dimension, jitter):
    points, rng = points_of(dimension), np.random.default_rng(7)
    step = rng.standard_normal((100, dimension))
    step *= jitter * spacing(points) / np.linalg.norm(step, axis=1, keepdims=True)
    chosen = points[rng.choice(len(points), 100, replace=False)]
    near = nearness(np.clip(chosen + step, -1, 1).astype(np.float32), points)
    assert is_near(near)
    assert near.mean_rank < 0.3


def test_points_to_the_last_bit_are_counted():
    points = points_of(6)
    assert nearness(points[:30], points).exact == 30
