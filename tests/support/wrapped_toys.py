"""Environments, agents and applications for the tests, which any process can import."""

from __future__ import annotations

from typing import ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation, NormalizeObservation

from sada_gym import GymnasiumApplication


def balance(state):
    return int(state[2] + state[3] > 0.0)


def swing(state):
    return np.array([-10.0 * state[1] - 2.0 * state[2]])


def approach(state):
    return int(state["position"][0] < state["goal"])


def upright(episode):
    return min(len(episode) / 500, 1.0)


class Reach(gym.Env):
    """A point walks along a line to a goal, and is told by a dictionary where both are."""

    metadata: ClassVar = {"render_modes": []}

    def __init__(self, speed=0.1, size=1, reward=1.0, fails=False):
        self.speed, self.reward, self.fails = speed, reward, fails
        self.steps = 30
        self.observation_space = spaces.Dict(
            {
                "position": spaces.Box(-5.0, 5.0, (size,), np.float32),
                "goal": spaces.Discrete(2),
            }
        )
        self.action_space = spaces.Discrete(2)
        self.wind = 0.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time = 0
        self.options = dict(options or {})
        self.position = np.full(self.observation_space["position"].shape, self.start())
        return self.look(), {}

    def start(self):
        return self.np_random.uniform(-1.0, 1.0)

    def look(self):
        return {"position": self.position.astype(np.float32), "goal": 1}

    def step(self, action):
        if self.fails:
            raise OverflowError("too far")
        self.time += 1
        self.position += self.speed * (2 * action - 1) + self.wind
        arrived = bool(abs(self.position[0] - 1.0) < 0.5 * self.speed)
        late = self.time >= self.steps
        return self.look(), self.reward * arrived, arrived, late, {"is_success": arrived}


class OneKey(Reach):
    """Its dictionary has one key, whose name is `observation`."""

    def __init__(self, speed=0.1):
        super().__init__(speed)
        self.observation_space = spaces.Dict({"observation": spaces.Box(-5.0, 5.0, (1,))})

    def look(self):
        return {"observation": self.position.astype(np.float32)}

    def reset(self, *, seed=None, options=None):
        gym.Env.reset(self, seed=seed)
        self.time, self.position = 0, np.full(1, self.start())
        return self.look(), {}


class Impure(Reach):
    """It draws from NumPy's global generator."""

    def start(self):
        return np.random.uniform(-1.0, 1.0)  # noqa: NPY002


class Shared(Reach):
    """Its episodes share a generator, seeded by the last of them."""

    generator: ClassVar = np.random.default_rng(0)

    def start(self):
        type(self).generator = np.random.default_rng(int(self.np_random.integers(1000)))
        return -1.0

    def step(self, action):
        self.wind = self.generator.normal(0.0, 0.05)
        return super().step(action)


def flat_cart_pole(render_mode=None):
    return FlattenObservation(gym.make("CartPole-v1", render_mode=render_mode))


def pushed_cart_pole(push="weak"):
    env = gym.make("CartPole-v1")
    env.unwrapped.force_mag = {"weak": 2.0, "strong": 10.0}[push]
    return env


def normalised_cart_pole(learning=True):
    env = NormalizeObservation(gym.make("CartPole-v1"))
    env.update_running_mean = learning
    return env


def set_length(env, value):
    env.length = value


def endless():
    return Reach()


def broken():
    raise RuntimeError("no world")


def cart_pole(environment="CartPole-v1", **kwargs):
    settings = {
        "agent": balance,
        "parameters": {"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        "score": ("return", 0.0, 500.0),
        "fooling_threshold": 0.5,
        "agent_id": "by hand",
    }
    return GymnasiumApplication(environment, **{**settings, **kwargs})


def pendulum(**kwargs):
    settings = {
        "agent": swing,
        "parameters": {"g": (5.0, 15.0), "m": (0.5, 2.0)},
        "score": ("return", -1700.0, 0.0),
        "fooling_threshold": 0.5,
        "max_steps": 60,
    }
    return GymnasiumApplication("Pendulum-v1", **{**settings, **kwargs})


def reach(environment=Reach, reward=None, fails=False, **kwargs):
    changed = {"reward": reward, "fails": fails or None}
    settings = {
        "agent": approach if environment is not OneKey else (lambda seen: 1),
        "parameters": {"speed": (0.05, 0.2)},
        "score": "success",
        "fooling_threshold": 0.5,
        "max_steps": 40,
        "env_kwargs": {key: value for key, value in changed.items() if value is not None},
        "agent_id": "by hand",
    }
    return GymnasiumApplication(environment, **{**settings, **kwargs})


def worlds(application, n=6):
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (n, len(application.parameters))), [*range(n)]
