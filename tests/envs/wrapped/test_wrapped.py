"""Tests of `GymnasiumApplication` from end to end."""

from __future__ import annotations

import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from sada_gym.attack import attack
from sada_gym.testing.purity import assert_pure


def balance(state):
    return int(state[2] + state[3] > 0.0)


def cart_pole(**kwargs):
    settings = {
        "agent": balance,
        "parameters": {"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        "score": ("return", 0.0, 500.0),
        "fooling_threshold": 0.5,
        "agent_id": "by hand",
    }
    return GymnasiumApplication("CartPole-v1", **{**settings, **kwargs})


def test_cart_pole_is_pure():
    assert_pure(cart_pole(), n=7, sizes=(1, 2, 7))


@pytest.mark.parametrize("workers", [1, 2])
def test_eight_lines_attack_cart_pole(tmp_path, workers):
    result = attack(
        cart_pole(), "random", budget=8, samples=8, out=tmp_path / "run", workers=workers
    )
    assert result.report.afr == pytest.approx(np.mean(result.samples.score <= 0.5))
