"""Distinct failures: wide gaps part them, whatever the number of parameters."""

from __future__ import annotations

import numpy as np
import pytest

from sada_gym.measures.groups import distinct
from sada_gym.parameters import Parameter, ParameterSpace


def space(dimension):
    return ParameterSpace(*(Parameter(f"x{i}", -1.0, 1.0) for i in range(dimension)))


def boxes(dimension, *centres, half=0.3, n=100):
    rng = np.random.default_rng(1)
    parts = [np.array(c) + rng.uniform(-half, half, (n, dimension)) for c in centres]
    return np.concatenate(parts).astype(np.float32)


@pytest.mark.parametrize("dimension", [1, 2, 5, 10])
@pytest.mark.parametrize("count", [1, 2, 10, 150, 800])
def test_uniform_failures_are_one_group(dimension, count):
    mu = np.random.default_rng(count).uniform(-1, 1, (count, dimension)).astype(np.float32)
    (group,) = distinct(mu, space(dimension))
    assert sorted(group.tolist()) == list(range(count))


@pytest.mark.parametrize("dimension", [2, 4, 10])
def test_groups_that_lie_apart_are_told_apart(dimension):
    corners = [-0.7], [0.7]
    mu = boxes(dimension, *(corner * dimension for corner in corners))
    groups = distinct(mu, space(dimension))
    assert sorted(sorted(group) for group in groups) == [[*range(100)], [*range(100, 200)]]


def test_a_stray_failure_is_no_group():
    mu = np.concatenate([boxes(2, [-0.7, -0.7], [0.7, 0.7]), [[-0.9, 0.9]]]).astype(np.float32)
    assert sorted(map(len, distinct(mu, space(2)))) == [100, 101]


def test_many_failures_are_all_in_a_group_and_the_middle_comes_first():
    mu = boxes(2, [-0.7, 0.0], [0.7, 0.0], n=900)
    first, second = distinct(mu, space(2))
    assert sorted([*first.tolist(), *second.tolist()]) == list(range(1_800))
    assert np.abs(mu[first[0]] - mu[first].mean(axis=0)).max() < 0.1
    assert np.abs(mu[first[1]] - mu[first[0]]).max() > 0.2


def test_equal_failures_are_one_group():
    assert len(distinct(np.zeros((50, 3), np.float32), space(3))) == 1
