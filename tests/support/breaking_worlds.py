"""An environment that breaks in some worlds, in a way of one's choice."""

from __future__ import annotations

import os
import signal
import sys
import time
from typing import ClassVar

import gymnasium as gym
import numpy as np

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import Attribute

REASONS = {
    "raises": "a step raised RuntimeError: unstable at 0x...",
    "exits": "SystemExit: 3",
    "nan reward": "a reward is nan",
    "nan observation": "an observation holds NaN",
    "memory": "MemoryError without a message at breaking_worlds.py",
    "silent": "AssertionError without a message at breaking_worlds.py",
    "segfault": "was ended by SIGSEGV",
    "os._exit": "ended with exit code 7",
}
SPEED = Attribute(0.0, 1e12, paths="data.qvel[3]")
TORSO = Attribute(-1.0, 9.0, paths="model.body_mass[1]")


class Breaking(gym.Env):
    """A point is pushed for five steps; where its mass is in a band, the fault happens."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}
    observation_space = gym.spaces.Box(-9, 9, (2,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, mass=1.0, wind=0.0, fault="none", where="step", render_mode=None):
        self.mass, self.wind, self.fault, self.where = mass, wind, fault, where
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.x = np.array([self.np_random.uniform(-1, 1), 0.0])
        return self.seen("reset"), {}

    def seen(self, where):
        now = breaks(self.mass) and where == self.where
        if now:
            self.break_down()
        seen = self.x.astype(np.float32)
        if (now and self.fault == "nan observation") or self.fault == "nan always":
            seen[1] = np.nan
        return seen

    def break_down(self):
        if self.fault == "raises":
            raise RuntimeError(f"unstable at {hex(id(self))}.")
        if self.fault == "exits":
            sys.exit(3)
        if self.fault == "memory":
            raise MemoryError
        if self.fault == "silent":
            assert self.steps < 0
        if self.fault == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.fault == "os._exit":
            os._exit(7)
        if self.fault == "hangs":
            time.sleep(600)
        if self.fault == "slow":
            time.sleep(0.1)

    def step(self, action):
        self.steps += 1
        self.x = self.x + 0.1 * np.array([self.x[1], (float(action[0]) - self.wind) / self.mass])
        reward = -abs(self.x[0])
        if breaks(self.mass) and self.fault == "nan reward":
            reward = np.nan
        return self.seen("step"), reward, self.steps == 5, False, {}

    def render(self):
        return np.full((4, 6, 3), self.steps, np.uint8)


def push(seen):
    return [-seen[0] - np.nan_to_num(seen[1])]


def still(seen):
    return np.zeros(3)


def breaking(fault, *, where="step", low=0.5, environment=Breaking, **kwargs):
    settings = {
        "agent": push,
        "agent_id": "push",
        "parameters": {"mass": (low, 2.0), "wind": (-0.5, 0.5)},
        "score": ("return", -5.0, 0.0),
        "fooling_threshold": 0.5,
        "max_steps": 20,
        "env_kwargs": {"fault": fault, "where": where},
    }
    return GymnasiumApplication(environment, **{**settings, **kwargs})


def breaks(mass):
    """Say where it breaks: in a tenth of all worlds, and at no end of the range."""
    return (mass > 1.8) & (mass < 1.95)


def uniform(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 2)).astype(np.float32)


def one_that_breaks():
    mu = uniform(12) * np.float32(0.5)
    mu[7, 0] = 0.87
    mu[3, 0] = 0.96  # it has neighbours that break
    return mu


def light(env):
    return env.mass <= 1.2


class Heaped(Breaking):
    """Each takes 16 MB."""

    def __init__(self, mass=1.0, wind=0.0):
        super().__init__(mass, wind)
        self.heap = np.ones(2**21)


class Sharing(Breaking):
    """The class keeps what the last reset set, for all its episodes."""

    last: ClassVar[dict] = {}

    def reset(self, **kwargs):
        self.last["wind"] = self.wind
        return super().reset(**kwargs)

    def step(self, action):
        self.wind = self.last["wind"]
        return super().step(action)


gym.register("Breaking-v0", Breaking, max_episode_steps=20)
