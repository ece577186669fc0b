"""Environments for a Python with NumPy alone: the interfaces of gym 0.21 and of dm_control."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np


class Box:
    def __init__(self, low, high, shape, dtype=np.float32):
        self.low, self.high = np.full(shape, low, dtype), np.full(shape, high, dtype)
        self.shape, self.dtype = shape, np.dtype(dtype)


class Discrete:
    shape, dtype = (), np.dtype(np.int64)

    def __init__(self, n):
        self.n = n


class Drift:
    """A point that drifts with the wind and is pushed back; gym 0.21's interface."""

    metadata: ClassVar = {"render.modes": ["rgb_array"], "video.frames_per_second": 20}
    gains: ClassVar = [0.2, 0.3]

    def __init__(self, wind=0.0, size=0.1, seeded=True):
        self.observation_space, self.action_space = Box(-9.0, 9.0, (2,)), Discrete(3)
        self.wind, self.size, self.mass, self.seeded = wind, size, np.array([1.0, 2.0]), seeded
        self.double = 2.0 * wind
        self.rng = np.random.RandomState(1)

    @property
    def unwrapped(self):
        return self

    def seed(self, seed=None):
        self.rng = np.random.RandomState(seed if self.seeded else None)

    def reset(self):
        self.place, self.time = self.rng.uniform(-1.0, 1.0, 2), 0
        return self.place.astype(np.float32)

    def step(self, action):
        if self.wind > 0.8:
            raise ArithmeticError("blown away")
        push = (int(action) - 1) * self.gains[0] / self.mass[0]
        moved = np.array([push + self.size * self.rng.randn(), 0.1 * self.wind])
        self.place = self.place + moved
        self.time += 1
        done = bool(abs(self.place[0]) > 2.0) or self.time >= 30
        late = {"TimeLimit.truncated": True} if self.time >= 30 else {}
        reward = np.float64(1.0 - abs(self.place[0]))
        return self.place.astype(np.float32), reward, done, {"gust": self.rng.rand(), **late}

    def render(self, mode="human"):
        assert mode == "rgb_array"
        return np.full((8, 8, 3), int(10 * abs(self.place[0])), np.uint8)

    def close(self):
        pass


def old(wind=0.0, size=0.1):
    return Drift(wind, size)


def unseeded():
    return Drift(seeded=False)


class Array:
    def __init__(self, shape, dtype=float):
        self.shape, self.dtype = shape, np.dtype(dtype)


class BoundedArray(Array):
    minimum, maximum = np.array([-1.0]), np.array([1.0])


class Control:
    """A point that is pushed; dm_control's interface."""

    def __init__(self):
        self.task = SimpleNamespace(random=np.random.RandomState(3))
        self.body = SimpleNamespace(model=SimpleNamespace(mass=np.ones(3)))

    def observation_spec(self):
        return {"place": Array((1,)), "time": Array((), np.int64)}

    def action_spec(self):
        return BoundedArray((1,))

    def _moment(self, last, reward):
        seen = {"place": self.place.copy(), "time": np.int64(self.time)}
        discount = 0.0 if abs(self.place[0]) > 3.0 else 1.0
        return SimpleNamespace(
            observation=seen, reward=reward, discount=discount, last=lambda: last
        )

    def reset(self):
        self.place, self.time = self.task.random.uniform(-1.0, 1.0, 1), 0
        return self._moment(last=False, reward=None)

    def step(self, action):
        self.place = self.place + 0.3 * np.asarray(action) / self.body.model.mass[1] + 0.1
        self.time += 1
        last = self.time >= 20 or bool(abs(self.place[0]) > 3.0)
        return self._moment(last, 1.0 - float(abs(self.place[0])))


def slow(wind=0.0, size=0.1, seconds=60.0):
    import time

    time.sleep(seconds * wind)
    return Drift(wind, size)
