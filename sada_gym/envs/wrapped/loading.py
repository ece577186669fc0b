"""Loads the agent that a user describes: an object, a file, or an agent in another process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy.typing as npt

from sada_gym.agents import resolve
from sada_gym.agents.agent_files import find_agent_file, load_agent_file
from sada_gym.agents.built_in import BUILT_IN, BuiltInAgent
from sada_gym.agents.contract import Agent, Interface, identity_of
from sada_gym.agents.functions import agent_of
from sada_gym.agents.remote.client import RemoteAgent
from sada_gym.agents.remote.places import place_of
from sada_gym.envs.wrapped.episodes import GymnasiumEpisodes
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize


@dataclass(frozen=True, eq=False)
class Privileged:
    """A second agent in the same worlds: what it cannot do may be no fault of the first one.

    `key` tells it from others: its identity, else its name. `unknown` is the object itself where
    nothing identifies it, else None.
    """

    name: str
    policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]]
    key: str
    unknown: Any


@dataclass(frozen=True)
class AgentLoader:
    """Loads agents for one environment; for what follows `interface` see `GymnasiumApplication`.

    `environment` identifies it, where it acts by itself.
    """

    environment: Callable[[], str]
    interface: Interface
    allow_pickle: bool
    vec_normalize: VecNormalize | Literal[False] | None
    deterministic: bool
    agent_timeout: float

    def load(self, agent: Any) -> tuple[Any, str]:
        """Return the agent that a user's description means, and its name, empty if it has none."""
        if isinstance(agent, str) and agent == BUILT_IN:
            return BuiltInAgent(self.interface.action_space, self.environment()), BUILT_IN
        place = place_of(agent)
        if place is not None:
            if self.vec_normalize:
                raise UserError(
                    f"Expected no vec_normalize with the agent in {place}, got one. Pass it to "
                    "sada_gym.serve there."
                )
            remote = RemoteAgent(
                place,
                self.interface,
                timeout_s=self.agent_timeout,
                deterministic=self.deterministic,
            )
            return remote, remote.name
        if not isinstance(agent, str | Path):
            return agent, ""
        file = find_agent_file(agent)
        loaded = load_agent_file(
            file,
            self.interface.observation_space,
            self.interface.action_space,
            allow_pickle=self.allow_pickle,
            has_statistics=self.vec_normalize is not None,
            environment=self.interface.task_id,
        )
        return loaded, file.stem

    def policy(self, loaded: Any, name: str) -> Agent[GymnasiumEpisodes, npt.NDArray[Any]]:
        """Return what acts for a loaded agent."""
        return agent_of(
            loaded,
            self.interface,
            name,
            normalisation=self.vec_normalize,
            deterministic=self.deterministic,
        )

    def privileged(self, agent: Any, application: str, agent_id: str | None) -> Privileged | None:
        """Return the privileged agent that a user's description means; None where it is None."""
        if agent is None:
            return None
        loaded, name = self.load(agent)
        name = name or resolve(loaded, application, None)[0]
        policy = self.policy(loaded, name)
        identity = identity_of(policy, loaded, agent_id)
        return Privileged(name, policy, identity or name, loaded if identity is None else None)
