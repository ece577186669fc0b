"""Closed loops under attack: a frozen agent acts in episodes to their ends."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Generic

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.agents.contract import Agent, identity_of
from sada_gym.application import Application
from sada_gym.envs.episodes.rollout import EpisodesT, Rollout, play, record
from sada_gym.frames import Frame
from sada_gym.parameters import Mu
from sada_gym.seeds import validate_seeds, validate_world

_AT_ONCE = 4
"""Worlds whose rollouts are held in memory together."""


class EpisodesApplication(Application, Generic[EpisodesT]):
    """A frozen agent acts in episodes that go on in lockstep.

    Args:
        agent: A shipped agent's name, a file of weights, a model, or an `Agent` as it is.
        agent_id: Names an in-memory model in evaluation stores; by default a hash of its weights.

    Attributes:
        acting: What chooses the actions: `agent` as an `Agent`.
    """

    def __init__(self, agent: str | Path | Any, agent_id: str | None) -> None:
        self.agent_name, self.agent = agents.resolve(agent, self.name, agent_id)
        self.policy: Agent[EpisodesT, npt.NDArray[Any]] = self._as_agent(self.agent)
        self._agent_id = agent_id

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the agent's weights, or over its `agent_id` and how it is used."""
        return identity_of(self.policy, self.agent, self._agent_id)

    @abstractmethod
    def _as_agent(self, given: Any) -> Agent[EpisodesT, npt.NDArray[Any]]:
        """Give the agent that a model means."""

    @abstractmethod
    def episodes(self, mu: Mu, seeds: Sequence[int]) -> EpisodesT:
        """Begin the episodes in the worlds of mu, (n, d); close them after use."""

    def play(self, episodes: EpisodesT, on_step: Callable[[EpisodesT], None] | None = None) -> None:
        """Let the agent act to the end of all episodes; `on_step` is called before every step."""
        play(self.policy, episodes, on_step)

    def rollouts(self, mu: npt.ArrayLike, seed: int) -> list[Rollout[Any]]:
        """Play all episodes in the world of one mu, (d,), and keep every step."""
        row, seed = validate_world(self.parameters, mu, seed)
        with closing(self.episodes(row, [seed])) as episodes:
            return record(self.policy, episodes)

    def rollouts_batch(
        self, mu: npt.ArrayLike, seeds: Sequence[int]
    ) -> Iterator[list[Rollout[Any]]]:
        """Give such rollouts of several worlds, (n, d), whose episodes go on in lockstep."""
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        for first in range(0, len(batch), _AT_ONCE):
            rows, some = batch[first : first + _AT_ONCE], checked[first : first + _AT_ONCE]
            with closing(self.episodes(rows, some)) as episodes:
                found = record(self.policy, episodes)
            count = len(found) // len(rows)
            yield from (found[start : start + count] for start in range(0, len(found), count))

    @abstractmethod
    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        """Draw every frame of a replay."""

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Play all episodes of one world, one after another: their frames, and the score."""
        rollouts = self.rollouts(mu, seed)
        return self._frames(rollouts), float(np.mean([rollout.score for rollout in rollouts]))
