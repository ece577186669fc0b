"""What a slow environment costs is told before an attack spends anything."""

from __future__ import annotations

import re
import time
import warnings

import gymnasium as gym
import numpy as np
import pytest

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import Attribute, Keyword
from sada_gym.errors import SlowWorlds


class Slow(gym.Env):
    """Its constructor, reset and steps take so many seconds; it never ends."""

    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, make_s=0.0, step_s=0.0, mass=1.0):
        self.step_s, self.mass = step_s, mass
        time.sleep(make_s)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        time.sleep(self.step_s)
        return np.zeros(1, np.float32), 1.0, False, False, {}


def slow(binding=Attribute, **kwargs):
    return GymnasiumApplication(
        Slow,
        agent=lambda observation: 1,
        agent_id="ones",
        parameters={"mass": binding(0.5, 2.0)},
        score=("length", 4),
        fooling_threshold=0.5,
        max_steps=4,
        **kwargs,
    )


def test_a_slow_constructor_is_told_with_what_saves_it():
    application = slow(env_kwargs={"make_s": 0.2})
    assert application.seconds_per_world >= 0.2
    assert re.match(r"Time: constructor \d+ %, .*; 4 steps\. reuse=True", application.costs)
    assert "reuse" not in slow(Keyword, env_kwargs={"make_s": 0.2}).costs
    kept = slow(env_kwargs={"make_s": 0.2}, reuse=True)
    assert kept.seconds_per_world is not None
    assert "constructor" not in kept.costs


def test_slow_steps_are_told_with_what_saves_them():
    application = slow(env_kwargs={"step_s": 0.05})
    assert application.seconds_per_world >= 0.2
    assert int(re.search(r"steps (\d+) %", application.costs)[1]) > 50
    assert "A smaller max_steps= would shorten episodes" in application.costs


def test_an_attack_says_so_before_it_starts(tmp_path, monkeypatch):
    given = {"budget": 0, "samples": 10, "pictures": False, "diagnose": False}
    with warnings.catch_warnings():
        warnings.simplefilter("error", SlowWorlds)
        attack(slow(), "random", out=tmp_path / "fast", **given)
    monkeypatch.setattr("sada_gym.evaluation.evaluator.SLOW_S", 0.1)
    with pytest.warns(SlowWorlds, match=r"a world; 10 worlds: \d+ s\. Time: .* workers"):
        attack(slow(env_kwargs={"step_s": 0.04}), "random", out=tmp_path / "slow", **given)


def test_a_world_that_breaks_or_may_hang_is_not_measured():
    application = slow(timeout=5.0)
    assert application.seconds_per_world is None
    for on_error in ("invalid", "raise"):
        broken = slow(env_kwargs={"step_s": -1.0}, on_error=on_error)  # time.sleep raises
        assert broken.seconds_per_world is None
        assert broken.costs == ""
