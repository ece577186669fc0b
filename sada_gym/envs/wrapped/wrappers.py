"""Wrappers that disturb what an agent sees or does; each is made for one episode."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

Env = gym.Env[Any, Any]


class NoisyObservations(gym.ObservationWrapper[Any, Any, Any]):
    """Adds Gaussian noise, which never takes a number out of the bounds of its space.

    Args:
        env: The environment.
        sd: The standard deviation of the noise.
        boxes: The spaces that are noisy, by their keys in a Dict; None is the key of a lone Box.
        entries: The entries of the flattened Boxes that are noisy; None means all.
        rng: Draws the noise.
    """

    def __init__(
        self,
        env: Env,
        sd: float,
        boxes: Mapping[str | None, spaces.Box[Any]],
        entries: tuple[int, ...] | None,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(env)
        self._sd, self._boxes, self._rng = sd, boxes, rng
        self._entries = None if entries is None else [*entries]

    def observation(self, observation: Any) -> Any:
        """Add noise."""
        if None in self._boxes:
            return self._noisy(observation, self._boxes[None])
        noisy = {key: self._noisy(observation[key], box) for key, box in self._boxes.items()}
        return {**observation, **noisy}

    def _noisy(self, value: Any, box: spaces.Box[Any]) -> Any:
        noise = self._rng.standard_normal(np.shape(value))
        if self._entries is not None:
            chosen = noise.reshape(-1)[self._entries]
            noise = np.zeros_like(noise)
            noise.reshape(-1)[self._entries] = chosen
        if not self._sd:
            return value
        clean = np.asarray(value, np.float64)
        noisy = clean + self._sd * noise
        if box.dtype.kind in "iu":
            noisy = np.rint(noisy)
        # an environment may leave its own bounds: only noise does not
        low, high = np.minimum(box.low, clean), np.maximum(box.high, clean)
        return np.clip(noisy, low, high).astype(np.asarray(value).dtype)


class LateObservations(gym.ObservationWrapper[Any, Any, Any]):
    """Shows what was the case some steps ago; until then, the first observation.

    Args:
        env: The environment.
        steps: The delay.
    """

    def __init__(self, env: Env, steps: int) -> None:
        super().__init__(env)
        self._queue: deque[Any] = deque(maxlen=steps + 1)

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._queue.clear()
        return super().reset(**kwargs)

    def observation(self, observation: Any) -> Any:
        """Hold the observation back, and show an older one."""
        self._queue.append(observation)
        return self._queue[0]


class LostObservations(gym.ObservationWrapper[Any, Any, Any]):
    """Shows the last observation again wherever one is lost; the first always arrives.

    Args:
        env: The environment.
        probability: The probability that an observation is lost.
        rng: Draws which ones are.
    """

    def __init__(self, env: Env, probability: float, rng: np.random.Generator) -> None:
        super().__init__(env)
        self._probability, self._rng = probability, rng
        self._first = True
        self._last: Any = None

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._first = True
        return super().reset(**kwargs)

    def observation(self, observation: Any) -> Any:
        """Show the observation, or the last one."""
        lost = self._rng.random() < self._probability
        if self._first or not lost:
            self._last = observation
        self._first = False
        return self._last


class LateActions(gym.ActionWrapper[Any, Any, Any]):
    """Lets an action act some steps after it was chosen.

    Until the first one arrives, a Box action is zero; of other actions the first one acts.

    Args:
        env: The environment.
        steps: The delay.
    """

    def __init__(self, env: Env, steps: int) -> None:
        super().__init__(env)
        self._queue: deque[Any] = deque(maxlen=steps + 1)
        self._steps = steps

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._queue.clear()
        if isinstance(self.action_space, spaces.Box):
            self._queue.extend([np.zeros(self.action_space.shape)] * self._steps)
        return super().reset(**kwargs)

    def action(self, action: Any) -> Any:
        """Hold the action back, and let an older one act."""
        self._queue.append(action)
        return self._queue[0]


class ScaledActions(gym.ActionWrapper[Any, Any, Any]):
    """Multiplies Box actions.

    Args:
        env: The environment.
        gain: The factor.
    """

    def __init__(self, env: Env, gain: float) -> None:
        super().__init__(env)
        self._gain = gain

    def action(self, action: Any) -> Any:
        """Multiply the action."""
        return np.asarray(action, np.float64) * self._gain


class NoisyActions(gym.ActionWrapper[Any, Any, Any]):
    """Adds Gaussian noise to Box actions, and replaces some of other actions by random ones.

    Args:
        env: The environment.
        level: The standard deviation as a share of half the Box's range; for other actions the
            probability that a uniformly drawn one acts instead.
        rng: Draws the noise.
    """

    def __init__(self, env: Env, level: float, rng: np.random.Generator) -> None:
        super().__init__(env)
        self._level, self._rng = level, rng

    def action(self, action: Any) -> Any:
        """Disturb the action."""
        space = self.action_space
        if isinstance(space, spaces.Box):
            half = (space.high.astype(np.float64) - space.low) / 2.0
            return action + self._level * half * self._rng.standard_normal(half.shape)
        other, swapped = self._draw(space), self._rng.random() < self._level
        return other if swapped else action

    def _draw(self, space: Any) -> Any:
        if isinstance(space, spaces.Discrete):
            return space.dtype.type(space.start + self._rng.integers(space.n))
        if isinstance(space, spaces.MultiDiscrete):
            return (space.start + self._rng.integers(space.nvec)).astype(space.dtype)
        return self._rng.integers(2, size=space.shape).astype(space.dtype)


class RepeatedSteps(gym.Wrapper[Any, Any, Any, Any]):
    """Lets each action act for some steps, or to the end of the episode; rewards are added.

    Args:
        env: The environment.
        count: The number of steps.
    """

    def __init__(self, env: Env, count: int) -> None:
        super().__init__(env)
        self._count = count

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take the steps."""
        total = 0.0
        for _ in range(self._count):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            if terminated or truncated:
                break
        return observation, total, terminated, truncated, info
