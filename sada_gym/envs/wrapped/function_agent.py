"""Plain functions as agents: observation -> action, called for one observation at a time."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from sada_gym.agents.contract import Indices
from sada_gym.determinism import one_thread
from sada_gym.envs.wrapped.episodes import GymnasiumEpisodes
from sada_gym.errors import UserError


class FunctionAgent:
    """Calls a function with one observation at a time.

    The function must remember nothing: episodes go on in lockstep, so that the next observation is
    that of another episode. Its name is for messages.
    """

    fingerprint = None

    def __init__(self, function: Callable[[Any], Any], name: str) -> None:
        self._function, self._name = function, name

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""

    def act(self, episodes: GymnasiumEpisodes, which: Indices) -> Any:
        """Return the list of the actions in some episodes, asked for one by one."""
        actions = []
        with one_thread():
            for i in which.tolist():
                observation = deepcopy(episodes.observation(i))
                try:
                    actions.append(self._function(observation))
                except Exception as error:  # whatever a user's function may raise
                    raise UserError(
                        f"Expected an action from {self._name} at {episodes.where(i)} for the "
                        f"observation {_short(observation)}, got {type(error).__name__}: {error}. "
                        "The agent is called as agent(observation), with one observation."
                    ) from error
        return actions


def _short(observation: Any) -> str:
    text = repr(observation) if not isinstance(observation, np.ndarray) else str(observation)
    return text if len(text) <= 100 else f"{text[:100]}..."
