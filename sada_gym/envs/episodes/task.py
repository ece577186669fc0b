"""Inner tasks, on which agents are trained, as Gymnasium environments: one, or many in lockstep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, ClassVar, Generic, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector.utils import batch_space

from sada_gym.agents.tile import Batch
from sada_gym.envs.checks import (
    check_kind,
    checked_actions,
    checked_render_mode,
    warn_without_render_mode,
)
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.episodes.rollout import EpisodesT
from sada_gym.envs.vector import SeededVectorEnv
from sada_gym.frames import Frame
from sada_gym.resets import check_reset_options, checked_seed

_FIRST = np.zeros(1, np.intp)


class StartDistribution(Protocol):
    """A distribution from which the starts of episodes are drawn."""

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw one start."""


class Task(ABC, Generic[EpisodesT]):
    """An inner task: episodes from a start distribution, and a reward for every step.

    The episodes live in the process that began them: a copy, or a task that was pickled, needs a
    reset.

    Args:
        distribution: Draws the starts; by default `distribution_class()`.
        count: Number of episodes.

    Attributes:
        episodes_class: The class of the episodes.
        distribution_class: The class of the distribution.
    """

    episodes_class: ClassVar[type[Episodes[Any]]]
    distribution_class: ClassVar[type[Any]]

    def __init__(self, distribution: StartDistribution | None, count: int) -> None:
        distribution = self.distribution_class() if distribution is None else distribution
        check_kind("distribution", distribution, self.distribution_class)
        self.distribution: Any = distribution
        self._count = count
        self._waiting: dict[int, Any] = {}
        self._episodes: EpisodesT | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the episodes."""
        return {**self.__dict__, "_episodes": None, "_waiting": {}}

    @property
    def episodes(self) -> EpisodesT:
        """The episodes that have begun.

        Raises:
            ResetNeeded: If not all of them have begun.
        """
        if self._episodes is None:
            raise ResetNeeded("Expected reset() first: no episode has begun yet.")
        return self._episodes

    def start(self, i: int, rng: np.random.Generator) -> None:
        """Begin another episode in place i."""
        start = self.distribution.draw(rng)
        if self._episodes is not None:
            self._episodes.begin(i, start)
            return
        self._waiting[i] = start
        if len(self._waiting) == self._count:
            self._episodes = self._begin([self._waiting[k] for k in range(self._count)])

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Take finite actions (n, ...), and give the rewards, (n,).

        Raises:
            ResetNeeded: If an episode has not begun or has ended.
        """
        if np.logical_or(*self.ended()).any():
            raise ResetNeeded("Expected reset() before step(): an episode has ended.")
        return self._step(self.episodes, actions)

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes, self._waiting = None, {}

    @abstractmethod
    def _begin(self, starts: Sequence[Any]) -> EpisodesT:
        """Begin all episodes."""

    @abstractmethod
    def _step(self, episodes: EpisodesT, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Take a step in each episode, and give the rewards, (n,)."""

    @abstractmethod
    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Say where an episode is terminated, and where it is truncated: (n,) each."""

    @abstractmethod
    def info(self, i: int) -> dict[str, Any]:
        """Give the info of episode i."""


class TaskEnv(gym.Env[Batch, npt.NDArray[Any]]):
    """One episode of an inner task at a time.

    A subclass sets `task_class` and `metadata`.

    Args:
        distribution: Draws the starts.
        render_mode: Among those of the class's `metadata`.
    """

    task_class: ClassVar[type[Task[Any]]]

    def __init__(
        self, distribution: StartDistribution | None = None, *, render_mode: str | None = None
    ) -> None:
        self.task = self.task_class(distribution, 1)
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        # copies: SB3's VecNormalize changes the space that it is given, and spaces hold generators
        spaces_of: Any = self.task_class.episodes_class
        self.observation_space: spaces.Dict = deepcopy(spaces_of.observation_space)  # type: ignore[assignment]
        self.action_space = deepcopy(spaces_of.action_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin another episode."""
        check_reset_options(options)
        super().reset(seed=checked_seed(seed))
        self.task.start(0, self.np_random)
        return self._observation(), self.task.info(0)

    def step(self, action: npt.NDArray[Any]) -> tuple[Batch, float, bool, bool, dict[str, Any]]:
        """Take one action."""
        reward = self.task.step(checked_actions(action, self.action_space, "an action")[None])
        terminated, truncated = self.task.ended()
        info = self.task.info(0)
        return self._observation(), float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Frame | None:
        """Give the camera's image."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        frame: Frame = self.task.episodes.render(_FIRST)[0]
        return frame

    def close(self) -> None:
        """Free what the episode holds; doing it again is fine."""
        self.task.close()

    def _observation(self) -> Batch:
        return {key: value[0] for key, value in self.task.episodes.observe(_FIRST).items()}


class TaskVectorEnv(SeededVectorEnv[Batch]):
    """Episodes in lockstep: equals `SyncVectorEnv` of `TaskEnv` with `AutoresetMode.SAME_STEP`.

    A subclass sets `task_class` and `metadata`.

    Args:
        distribution: Draws the starts.
        num_envs: Number of environments.
        render_mode: Among those of the class's `metadata`.
    """

    task_class: ClassVar[type[Task[Any]]]

    def __init__(
        self,
        distribution: StartDistribution | None = None,
        *,
        num_envs: int = 1,
        render_mode: str | None = None,
    ) -> None:
        # first: Gymnasium closes what was refused
        self.task = self.task_class(distribution, num_envs)
        super().__init__(num_envs=num_envs, render_mode=render_mode)
        spaces_of: Any = self.task_class.episodes_class
        self.single_observation_space: spaces.Dict = deepcopy(spaces_of.observation_space)
        self.single_action_space = deepcopy(spaces_of.action_space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._everyone = np.arange(num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin other episodes, all or those in the boolean array `options["reset_mask"]`.

        Args:
            seed: An int (environment i gets seed + i) or a sequence of one seed an environment.
            options: `reset_mask`, (num_envs,) bool, where only some are to be reset.
        """
        for i, _ in self._reseeded(seed, options):
            self.task.start(i, self._generators[i])
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            infos = self._add_info(infos, self.task.info(i), i)
        return self.task.episodes.observe(self._everyone), infos

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Batch,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Take one action each; where an episode ends, another begins."""
        reward = self.task.step(checked_actions(actions, self.action_space, "actions"))
        terminated, truncated = self.task.ended()
        ended = np.flatnonzero(terminated | truncated)
        last = self.task.episodes.observe(ended)
        infos: dict[str, Any] = {}
        for i in self._everyone.tolist():
            info = self.task.info(i)
            if terminated[i] or truncated[i]:
                row = int(np.searchsorted(ended, i))
                final = {key: value[row] for key, value in last.items()}
                infos = self._add_info(infos, {"final_obs": final, "final_info": info}, i)
                self.task.start(i, self._generators[i])
                info = self.task.info(i)
            infos = self._add_info(infos, info, i)
        observation = self.task.episodes.observe(self._everyone)
        return observation, reward, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Give each camera's image."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return tuple(self.task.episodes.render(self._everyone))

    def close_extras(self, **_: Any) -> None:
        """Free what the episodes hold."""
        self.task.close()
