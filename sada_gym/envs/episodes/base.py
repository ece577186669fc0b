"""Episodes that go on in lockstep: what a simulator offers, and agents that act to their ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.contract import Agent
from sada_gym.agents.tile import Batch
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes, Floats, Indices
from sada_gym.foundations.determinism import single_threaded

StartT = TypeVar("StartT")


class Episodes(ABC, Generic[StartT]):
    """Episodes of one simulator that go on in lockstep, each as if it were alone.

    A subclass begins each episode in its `__init__`, and counts a step of `steps` wherever an agent
    acted. What happens in one episode must not depend on the others, to the last bit.

    Attributes:
        task_id: The id of the inner task that trains agents for these episodes, for messages.
        observation_space: The space of one episode's observations.
        action_space: The space of one episode's actions.
        finite_only: Whether an action that is not finite is an error. Otherwise the episode itself
            says what becomes of it.
        starts: How each episode began.
        steps: (n,) int64, the number of actions taken in each.
    """

    task_id: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    finite_only: bool = True

    def __init__(self, starts: Sequence[StartT]) -> None:
        self.starts = [*starts]
        self.steps = np.zeros(len(starts), np.int64)

    def __len__(self) -> int:
        """Count the episodes."""
        return len(self.starts)

    @abstractmethod
    def begin(self, i: int, start: StartT) -> None:
        """Begin another episode in place i."""

    @abstractmethod
    def under_way(self) -> Indices:
        """Return the episodes that have not ended."""

    @property
    @abstractmethod
    def score(self) -> Floats:
        """The score Q of each episode so far, (n,)."""

    @abstractmethod
    def observe(self, which: Indices) -> Batch:
        """Return the observations of some episodes, each key (len(which), ...)."""

    @abstractmethod
    def render(self, which: Indices) -> Bytes:
        """Draw frames of some episodes, (len(which), rows, columns, 3)."""

    @abstractmethod
    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Take one action (k,) in each of some episodes: actions (len(which), k)."""

    @abstractmethod
    def snapshot(self) -> Batch:
        """Return what a rollout keeps of the current step, each key (n, ...)."""

    def _validate_actions(self, which: Indices, actions: npt.NDArray[Any]) -> Floats:
        """Return a copy of the actions in some episodes as float64.

        Raises:
            UserError: If they are of another shape, or not finite where episodes take none such.
        """
        copied = np.array(actions, np.float64)
        shape = (len(which), *(self.action_space.shape or ()))
        if copied.shape != shape:
            raise UserError(
                f"Expected actions of shape {shape}, one for each of the episodes under way, got "
                f"{copied.shape}."
            )
        finite = np.isfinite(copied).all(axis=1)
        if self.finite_only and not finite.all():
            first = int(finite.argmin())
            raise UserError(
                f"Expected finite actions, got {copied[first].tolist()} at "
                f"{self.where(int(which[first]))}. Look for NaN or infinity in the agent."
            )
        return copied

    def info(self, i: int) -> dict[str, Any]:  # noqa: ARG002
        """Say what became of episode i, where a world is one episode: JSON-compatible."""
        return {}

    def where(self, i: int) -> str:
        """Say in a few words where episode i is, for messages."""
        return f"step {self.steps[i]}"

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""


EpisodesT = TypeVar("EpisodesT", bound=Episodes[Any])


def play(
    agent: Agent[EpisodesT, npt.NDArray[Any]],
    episodes: EpisodesT,
    on_step: Callable[[EpisodesT], None] | None = None,
) -> None:
    """Let an agent act in all episodes to their ends, in one thread: see `single_threaded`.

    The episodes may be at any step; `on_step` is called before every one.
    """
    with single_threaded():  # for replays, too: they end with the same score
        agent.start(len(episodes))
        while len(which := episodes.under_way()):
            if on_step is not None:
                on_step(episodes)
            episodes.step(which, agent.act(episodes, which))


@dataclass(frozen=True)
class Rollout(Generic[StartT]):
    """One episode, step by step."""

    start: StartT
    # what `Episodes.snapshot` gave before every step and at the end: each key has (steps + 1, ...)
    snapshots: Mapping[str, npt.NDArray[Any]]
    score: float

    def __getitem__(self, key: str) -> npt.NDArray[Any]:
        """Return one key of the snapshots."""
        return self.snapshots[key]

    @property
    def last(self) -> int:
        """The number of the last snapshot, which is that of the steps."""
        return len(next(iter(self.snapshots.values()))) - 1


def record(agent: Agent[EpisodesT, npt.NDArray[Any]], episodes: EpisodesT) -> list[Rollout[Any]]:
    """Let an agent act in episodes from their starts to their ends, and keep every step."""
    kept: list[Batch] = []

    def keep(now: EpisodesT) -> None:
        kept.append({key: value.copy() for key, value in now.snapshot().items()})

    play(agent, episodes, keep)
    keep(episodes)
    return [
        Rollout(
            start,
            {
                key: np.array([snapshot[key][i] for snapshot in kept[: steps + 1]])
                for key in kept[0]
            },
            score,
        )
        for i, (start, steps, score) in enumerate(
            zip(episodes.starts, episodes.steps.tolist(), episodes.score.tolist(), strict=True)
        )
    ]
