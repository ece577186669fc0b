"""A second agent in the same worlds: what it cannot do may be no fault of the first one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from sada_gym.agents.contract import Agent, identity_of
from sada_gym.envs.wrapped.episodes import GymnasiumEpisodes


@dataclass(frozen=True, eq=False)
class Privileged:
    """A privileged agent.

    Attributes:
        name: What messages call it.
        policy: What acts.
        key: What tells it from others: its identity, else its name.
        unknown: The object itself, where nothing identifies it; else None.
    """

    name: str
    policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]]
    key: str
    unknown: Any

    @classmethod
    def of(
        cls,
        name: str,
        policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]],
        given: Any,
        agent_id: str | None,
    ) -> Privileged:
        """Describe what acts for a user's object."""
        identity = identity_of(policy, given, agent_id)
        return cls(name, policy, identity or name, given if identity is None else None)
