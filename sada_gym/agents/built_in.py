"""The agent of an environment that acts by itself, by an autopilot or another controller inside."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from sada_gym.agents.contract import Indices

BUILT_IN = "built-in"
"""What `agent=` is then."""


class BuiltInAgent:
    """Gives the zero of the action space, or its nearest action.

    `fingerprint` says which environment acts.
    """

    def __init__(self, space: spaces.Space[Any], fingerprint: str) -> None:
        self.fingerprint = fingerprint
        if isinstance(space, spaces.Box):
            self._action = np.zeros(space.shape).clip(space.low, space.high).astype(space.dtype)
        elif isinstance(space, spaces.Discrete):
            self._action = np.clip(0, space.start, space.start + space.n - 1)
        else:
            start = getattr(space, "start", np.zeros(space.shape or (), np.int64))
            self._action = np.maximum(start, 0)

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""

    def act(self, episodes: Any, which: Indices) -> list[Any]:  # noqa: ARG002
        """Return the action in each of some episodes."""
        return [self._action] * len(which)
