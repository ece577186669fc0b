"""What matters: Sobol's indices where they are known, curves, and when nothing is said."""

import numpy as np
import pytest

from sada_gym.measures.sensitivity import MAX_PARAMETERS, fit_failures


def worlds(n, d, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, d)).astype(np.float32)


@pytest.mark.parametrize("dimension", [2, 6])
def test_the_indices_are_those_of_a_corner(dimension):
    mu = worlds(2_000, dimension)
    model = fit_failures(mu, (mu[:, 0] > 0.2) & (mu[:, 1] < 0.5))
    influences = model.influences([f"x{i}" for i in range(dimension)])
    p, q = 0.4, 0.75  # the chances of both conditions; V = pq (1 - pq)
    variance = p * q * (1 - p * q)
    first = {"x0": q * q * p * (1 - p) / variance, "x1": p * p * q * (1 - q) / variance}
    assert [influence.parameter for influence in influences[:2]] == ["x0", "x1"]
    for influence in influences:
        other = {"x0": "x1", "x1": "x0"}.get(influence.parameter)
        total = 0.0 if other is None else 1.0 - first[other]
        assert influence.first == pytest.approx(first.get(influence.parameter, 0.0), abs=0.05)
        assert influence.total == pytest.approx(total, abs=0.05)
        low, high = influence.total_interval
        assert low <= influence.total <= high


def test_one_parameter_explains_everything():
    mu = worlds(500, 1)
    (influence,) = fit_failures(mu, mu[:, 0] > 0.4).influences(["x"])
    assert influence.first == pytest.approx(1.0, abs=0.05)
    assert influence.total == pytest.approx(1.0, abs=0.05)


def test_a_chance_is_no_certainty():
    mu = worlds(3_000, 3)
    chance = np.where(mu[:, 0] > 0, 0.8, 0.2)
    fooled = np.random.default_rng(1).random(len(mu)) < chance
    model = fit_failures(mu, fooled)
    values, (mean, low, high) = model.curve(0)
    np.testing.assert_allclose(mean[values < -0.2], 0.2, atol=0.1)
    np.testing.assert_allclose(mean[values > 0.2], 0.8, atol=0.1)
    assert (low <= mean).all()
    assert (mean <= high).all()
    assert model.influences("abc")[0].parameter == "a"


def test_the_map_shows_both_parameters():
    mu = worlds(2_000, 3)
    model = fit_failures(mu, (mu[:, 0] > 0.2) & (mu[:, 1] < 0.5))
    values, mean = model.map(0, 1)
    x, y = np.meshgrid(values, values)
    inside = (x > 0.3) & (y < 0.4)
    outside = (x < 0.1) | (y > 0.6)
    assert mean[inside].min() > 0.8
    assert mean[outside].max() < 0.2


def test_queries_that_were_chosen_do_not_bend_the_curve():
    mu = worlds(4_000, 2)
    fooled = mu[:, 0] > 0.5
    chosen = fooled | (np.random.default_rng(2).random(len(mu)) < 0.3)
    _, (mean, _, _) = fit_failures(mu[chosen], fooled[chosen]).curve(0)
    assert mean.mean() == pytest.approx(0.25, abs=0.04)


@pytest.mark.parametrize(
    ("mu", "fooled"),
    [
        (worlds(99, 2), np.arange(99) < 50),
        (worlds(400, 2), np.arange(400) < 9),
        (worlds(400, 2), np.arange(400) >= 9),
        (worlds(400, MAX_PARAMETERS + 1), np.arange(400) < 200),
        (worlds(0, 2), np.zeros(0, bool)),
    ],
)
def test_nothing_is_said_of_too_little(mu, fooled):
    assert fit_failures(mu, fooled) is None


def test_it_is_the_same_every_time():
    mu = worlds(500, 4)
    names = "abcd"
    one, other = (fit_failures(mu, mu[:, 2] > 0).influences(names) for _ in range(2))
    assert one == other
