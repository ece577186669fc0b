"""Closed loops under attack: a frozen agent acts in episodes to their ends."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeAlias

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym import agents
from sada_gym.agents.contract import Agent, identity_of
from sada_gym.agents.policy import as_policy
from sada_gym.agents.wrappers import Predictor
from sada_gym.application import Application, Scored, isolated_rng, validate_world
from sada_gym.envs.episodes.base import Episodes, EpisodesT, Rollout, play, record
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.drawing import caption, stacked
from sada_gym.foundations.frames import Frame, LegendEntry, Take
from sada_gym.foundations.lazy import load
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.parameters import Mu

AgentLike: TypeAlias = str | Path | Predictor | Agent[Any, npt.NDArray[Any]]
"""A shipped agent's name, a file of weights, a model, or an agent as it is."""
_AT_ONCE = 4
"""Worlds whose rollouts are held in memory together."""
_LETTERS = 34
"""How many letters' heights a replay's frame is wide."""


class EpisodesApplication(Application, Generic[EpisodesT]):
    """A frozen agent acts in episodes that go on in lockstep.

    Args:
        agent: A shipped agent's name, a file of weights, a model, or an `Agent` as it is.
        agent_id: Names an in-memory model for stored scores; by default a hash of its weights.

    Attributes:
        policy: What chooses the actions: `agent` as an `Agent`.
        worlds_at_once: The most worlds whose episodes are in lockstep.
    """

    worlds_at_once: ClassVar[int] = 2**20

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
        """Return the agent that a model means."""

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
        """Yield such rollouts of several worlds, (n, d), whose episodes go on in lockstep."""
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        at_once = min(_AT_ONCE, self.worlds_at_once)
        for first in range(0, len(batch), at_once):
            last = first + at_once
            rows, row_seeds = batch[first:last], checked[first:last]
            with closing(self.episodes(rows, row_seeds)) as episodes:
                rollouts = record(self.policy, episodes)
            count = len(rollouts) // len(rows)
            yield from (rollouts[i : i + count] for i in range(0, len(rollouts), count))

    @abstractmethod
    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        """Draw every frame of a replay."""

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Play all episodes of one world, one after another: their frames, and the score."""
        rollouts = self.rollouts(mu, seed)
        return self._frames(rollouts), float(np.mean([rollout.score for rollout in rollouts]))


class SimulatorApplication(EpisodesApplication[EpisodesT]):
    """A frozen agent acts in episodes of a simulator of ours, and a module draws its rollouts.

    Attributes:
        episodes_class: The class of the episodes.
        frame_module: The module that draws: its `LEGEND`, `summary` of the rollouts of one world,
            `picture` of a step of one of them with a line on it, and `observation` of a rollout's
            first step.
        steps_a_frame: How many steps of the agent go by from one frame of a replay to the next.
        behaviour_module: The module whose `behaviour` says what became of the episodes of one
            world, from their numbers among episodes that have ended, and whose `ending` says how a
            rollout ended and which step shows it.
        privileged_agent: `module:Class` of an agent that knows the whole world; "" if there is
            none.
    """

    episodes_class: ClassVar[type[Episodes[Any]]]
    frame_module: ClassVar[str]
    steps_a_frame: ClassVar[int] = 1
    behaviour_module: ClassVar[str]
    privileged_agent: ClassVar[str] = ""

    def _as_agent(self, given: Any) -> Agent[EpisodesT, npt.NDArray[Any]]:
        episodes: Any = self.episodes_class
        return as_policy(given, episodes)

    def _played(
        self, agent: Agent[EpisodesT, npt.NDArray[Any]], mu: Mu, seeds: Sequence[int]
    ) -> Iterator[tuple[slice, EpisodesT]]:
        """Play all episodes to their ends; yield them with the worlds that they belong to."""
        for first in range(0, len(mu), self.worlds_at_once):
            worlds = slice(first, first + self.worlds_at_once)
            episodes = self.episodes(mu[worlds], seeds[worlds])
            play(agent, episodes)
            yield worlds, episodes

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        """Score each world by its one episode, whose `info` becomes the world's.

        A subclass with several episodes a world puts their scores together itself.
        """
        scores, extras = [], []
        for _, episodes in self._played(self.policy, mu, seeds):
            scores.append(episodes.score)
            extras += [episodes.info(i) for i in range(len(episodes))]
        return Scored(np.concatenate(scores), extras)

    def privileged_score(
        self, mu: npt.ArrayLike, seeds: Sequence[int] | None = None
    ) -> Floats | None:
        """Score the privileged agent: what it cannot do can hardly be done.

        Takes what `Application.privileged_score` takes; without seeds, all are 0.
        """
        if not self.privileged_agent:
            return None
        batch = self.parameters.validate(mu)
        checked = [0] * len(batch) if seeds is None else validate_seeds(seeds, len(batch))
        scores = [np.empty(0)]
        for worlds, episodes in self._played(load(self.privileged_agent)(), batch, checked):
            scores.append(episodes.score.reshape(len(batch[worlds]), -1).mean(axis=1))
        return np.concatenate(scores)

    def behaviours(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> tuple[Behaviour, ...]:
        """Play the episodes of n worlds, (n, d), again, and say how they ended."""
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        behaviour = load(f"{self.behaviour_module}:behaviour")
        found: list[Behaviour] = []
        with isolated_rng(self):
            for worlds, episodes in self._played(self.policy, batch, checked):
                each = len(episodes) // len(batch[worlds])
                found += [
                    behaviour(episodes, range(first, first + each))
                    for first in range(0, len(episodes), each)
                ]
        return tuple(found)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """What the marks in frames mean."""
        legend: tuple[LegendEntry, ...] = load(f"{self.frame_module}:LEGEND")
        return legend

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what became of all episodes in the world of one mu, (d,)."""
        one_world: Any = [mu]
        return next(self.render_batch(one_world, [seed]))

    def render_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw such frames of several worlds, whose episodes go on in lockstep."""
        return map(load(f"{self.frame_module}:summary"), self.rollouts_batch(mu, seeds))

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what the agent sees at the start of the first episode."""
        row, seed = validate_world(self.parameters, mu, seed)
        with closing(self.episodes(row, [seed])) as episodes:
            first = {key: values[:1] for key, values in episodes.snapshot().items()}
            rollout = Rollout(episodes.starts[0], first, 0.0)
            frame: Frame = load(f"{self.frame_module}:observation")(rollout)
        return frame

    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        frames: list[Frame] = []
        for i, rollout in enumerate(rollouts):
            for step in self._steps(rollout.last):
                picture, text = self._picture(rollouts, i, step)
                said = caption(text, picture.width, picture.width // _LETTERS)
                frames.append(stacked([picture, said]))
            frames += frames[-1:] * (int(self.render_fps) - 1)  # a second to read how it ended
        return frames

    def takes(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Take], float]:
        """Play all episodes of one world again, for a film: each of them, and the score."""
        rollouts = self.rollouts(mu, seed)
        takes = [self._take(rollouts, i) for i in range(len(rollouts))]
        return takes, float(np.mean([rollout.score for rollout in rollouts]))

    def _take(self, rollouts: list[Rollout[Any]], i: int) -> Take:
        ending, last = load(f"{self.behaviour_module}:ending")(rollouts[i])
        steps = self._steps(last)

        def draw(number: int) -> tuple[Frame, str]:
            picture, text = self._picture(rollouts, i, steps[number])
            return np.asarray(picture), re.sub(r"   +", "  ·  ", text.partition("\n")[0].strip())

        return Take(len(steps), draw, ending, rollouts[i].score < 1)

    def _steps(self, last: int) -> list[int]:
        return [*range(0, last, self.steps_a_frame), last]

    def _picture(self, rollouts: list[Rollout[Any]], i: int, step: int) -> tuple[Image.Image, str]:
        drawn: tuple[Image.Image, str] = load(f"{self.frame_module}:picture")(rollouts, i, step)
        return drawn
