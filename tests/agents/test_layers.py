"""Parts of networks as kernels."""

import math

import numpy as np
import pytest

from sada_gym.agents.layers import dense, exponential


def test_a_dense_layer():
    draw = np.random.default_rng(0)
    inputs, weights, biases = draw.normal(size=5), draw.normal(size=(5, 3)), draw.normal(size=3)
    before = biases.copy()
    assert dense(inputs, weights, biases) == pytest.approx(inputs @ weights + biases)
    assert (biases == before).all()


def test_the_exponential_function():
    for x in (*np.linspace(-40.0, 40.0, 999).tolist(), 0.0, 599.0, -599.0):
        assert exponential(x) == pytest.approx(math.exp(x), rel=4e-16)
    assert exponential(1e9) == exponential(600.0) < math.inf
    assert exponential(-1e9) == exponential(-600.0) > 0.0
