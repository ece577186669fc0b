"""A simulator of which a process can hold one engine, as of MetaDrive, libsumo and CARLA."""

from __future__ import annotations

import time
from typing import ClassVar

import gymnasium as gym
import numpy as np

from sada_gym import GymnasiumApplication

ALIVE: list[Engine] = []
most_alive = 0
made = 0


class Engine:
    """What only so many environments of a process may have; `second` says what becomes of more."""

    def __init__(self, second):
        global made, most_alive
        made += 1
        if ALIVE and second == "raises":
            raise AssertionError("Can not call this API after engine initialization!")
        while ALIVE and second == "hangs":
            time.sleep(0.01)
        ALIVE.append(self)
        most_alive = max(most_alive, len(ALIVE))

    def close(self):
        if self in ALIVE:
            ALIVE.remove(self)


class OneEngine(gym.Env):
    """A block is pushed up a slope by an engine, for eight steps; `weight` does not follow mass."""

    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 8}
    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, render_mode=None, second="raises", slope=0.1, late=False):
        self.render_mode, self.second, self.slope, self.late = render_mode, second, slope, late
        self.mass = 2.0
        self.drag = np.array([0.1, 0.2])
        self.weight = self.mass * 9.81
        self.engine = None if late else Engine(second)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.engine is None:
            self.engine = Engine(self.second)
        self.steps = 0
        self.x = self.np_random.normal(size=2) * 0.1
        return self.x.astype(np.float32), {}

    def step(self, action):
        assert self.engine in ALIVE
        self.steps += 1
        force = 4 * float(action[0]) - self.weight * self.slope - self.drag[0] * self.x[1]
        self.x = self.x + 0.1 * np.array([self.x[1], force / self.mass])
        return self.x.astype(np.float32), float(-abs(self.x[0])), self.steps == 8, False, {}

    def render(self):
        return np.full((4, 6, 3), 100 + np.clip(self.x * 50, -99, 99)[0], np.uint8)

    def close(self):
        if self.engine is not None:
            self.engine.close()
        self.engine = self.mass = self.weight = None


def hold(seen):
    return [-seen[0] - seen[1]]


def one_engine(second="raises", *, late=False, **kwargs):
    settings = {
        "agent": hold,
        "agent_id": "hold",
        "parameters": {"mass": (1.0, 4.0), "slope": (0.0, 0.3)},
        "derived": {"weight": "mass * 9.81"},
        "score": ("return", -5.0, 0.0),
        "fooling_threshold": 0.5,
        "max_steps": 20,
        "env_kwargs": {"second": second, "late": late},
    }
    return GymnasiumApplication(OneEngine, **{**settings, **kwargs})


gym.register("OneEngine-v0", OneEngine, max_episode_steps=20)
