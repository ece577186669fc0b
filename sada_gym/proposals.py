"""The meta-episodes of proposing mu: their spaces, and how many proposals are left."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded

from sada_gym.errors import UserError, check_integer

Observation = npt.NDArray[np.float32]

MAX_ENVS = 2**20
"""Environments in one batch. Each keeps a generator, some kilobytes."""

MAX_HORIZON = 2**31 - 1
"""Proposals in one episode."""


def proposal_spaces(dimension: int) -> tuple[gym.spaces.Box[Any], gym.spaces.Box[Any]]:
    """Give the action space, mu, and the observation space of environments of d parameters."""
    return (
        gym.spaces.Box(-1.0, 1.0, (dimension,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (dimension + 2,), np.float32),
    )


class Proposals:
    """The meta-episodes of n environments in lockstep, for scalar and vector ones alike.

    Args:
        dimension: d, the number of semantic parameters.
        horizon: Proposals in one episode.
        count: n.

    Attributes:
        observation: (n, d + 2) float32: last mu, last score, share of the steps left. Hand out
            copies.

    Raises:
        UserError: If the horizon is no int of at least 1, or too large to be counted down.
    """

    def __init__(self, dimension: int, horizon: int, count: int) -> None:
        if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 1:
            raise UserError(f"Expected horizon to be an int of at least 1, got {horizon!r}.")
        check_integer("horizon", horizon, 1, MAX_HORIZON)
        self.observation: Observation = np.zeros((count, dimension + 2), dtype=np.float32)
        self._horizon = horizon
        self._steps_left = np.zeros(count, dtype=np.int64)

    @property
    def over(self) -> npt.NDArray[np.bool_]:
        """Where no step is left, or no episode has begun: (n,) bool."""
        over: npt.NDArray[np.bool_] = self._steps_left == 0
        return over

    def start(self, index: int) -> None:
        """Begin one episode."""
        self._steps_left[index] = self._horizon
        self.observation[index] = 0.0
        self.observation[index, -1] = 1.0

    def check_begun(self) -> None:
        """Check that every episode has a step left.

        Raises:
            ResetNeeded: If one has none.
        """
        if self.over.any():
            raise ResetNeeded("Expected reset() before step(): no episode has a step left.")

    def record(self, mu: npt.NDArray[Any], scores: npt.NDArray[np.float64]) -> None:
        """Take a step of every episode: mu (n, d) scored (n,); the box clips the scores."""
        self._steps_left -= 1
        self.observation[:, :-2] = mu
        self.observation[:, -2] = np.clip(scores, -1.0, 1.0)
        self.observation[:, -1] = self._steps_left / self._horizon
