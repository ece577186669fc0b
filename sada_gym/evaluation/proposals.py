"""The meta-episodes of proposing mu: their spaces, and how many proposals are left."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded

from sada_gym.errors import UserError, check_integer
from sada_gym.foundations.arrays import Floats, Floats32, Indices
from sada_gym.foundations.lockstep import Lockstep, Transition

MAX_HORIZON = 2**31 - 1
"""Proposals in one episode."""


def proposal_spaces(dimension: int) -> tuple[gym.spaces.Box[Any], gym.spaces.Box[Any]]:
    """Return the action space, mu, and the observation space of environments of d parameters."""
    return (
        gym.spaces.Box(-1.0, 1.0, (dimension,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (dimension + 2,), np.float32),
    )


class Proposals(Lockstep[Floats32]):
    """Meta-episodes of `count` environments: an action is one mu, its reward is minus its score.

    `horizon` is the number of proposals in one episode. It raises `UserError` if that is no int of
    at least 1, or too large to be counted down.
    """

    def __init__(self, dimension: int, horizon: int, count: int) -> None:
        super().__init__(count)
        if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 1:
            raise UserError(f"Expected horizon to be an int of at least 1, got {horizon!r}.")
        check_integer("horizon", horizon, 1, MAX_HORIZON)
        self.action_space, self.observation_space = proposal_spaces(dimension)
        # last mu, last score, share of the steps left
        self._observation: Floats32 = np.zeros((count, dimension + 2), np.float32)
        self._horizon = horizon
        self._steps_left = np.zeros(count, np.int64)

    def begin(
        self,
        i: int,
        seed: int | None,  # noqa: ARG002
        rng: np.random.Generator,  # noqa: ARG002
        *,
        autoreset: bool = False,  # noqa: ARG002
    ) -> None:
        """Begin an episode in environment i."""
        self._steps_left[i] = self._horizon
        self._observation[i] = 0.0
        self._observation[i, -1] = 1.0

    def observe(self, which: Indices) -> Floats32:
        """Return (len(which), d + 2): last mu, last score, share of the steps left."""
        return self._observation[which]

    def step(
        self, actions: npt.NDArray[Any], generators: Sequence[np.random.Generator]
    ) -> Transition:
        """Score one mu of each environment, (n, d); the box clips the scores observed."""
        if (self._steps_left == 0).any():
            raise ResetNeeded("Expected reset() before step(): no episode has a step left.")
        mu, score, infos = self._score(actions, generators)
        self._steps_left -= 1
        self._observation[:, :-2] = mu
        self._observation[:, -2] = np.clip(score, -1.0, 1.0)
        self._observation[:, -1] = self._steps_left / self._horizon
        return Transition(
            -score, self._steps_left == 0, np.zeros(self.count, dtype=np.bool_), infos
        )

    @abstractmethod
    def _score(
        self, mu: npt.NDArray[Any], generators: Sequence[np.random.Generator]
    ) -> tuple[npt.NDArray[Any], Floats, Sequence[dict[str, Any]]]:
        """Return the mu that were scored, their scores, (n,), and their infos."""
