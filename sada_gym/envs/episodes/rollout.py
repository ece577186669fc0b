"""An agent acts in episodes to their ends; a rollout keeps every step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes, StartT
from sada_gym.foundations.determinism import single_threaded

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
