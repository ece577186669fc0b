"""Inner tasks, on which agents are trained, as Gymnasium environments: one, or many in lockstep."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, ClassVar, Generic, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded

from sada_gym.agents.tile import Batch
from sada_gym.envs.checks import check_kind
from sada_gym.envs.episodes.base import Episodes, EpisodesT
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools, Bytes, Floats, Indices, validate_shape
from sada_gym.foundations.lockstep import Lockstep, LockstepEnv, LockstepVectorEnv, Transition


class StartDistribution(Protocol):
    """A distribution from which the starts of episodes are drawn."""

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw one start."""


class Task(Lockstep[Batch], Generic[EpisodesT]):
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
        super().__init__(count)
        distribution = self.distribution_class() if distribution is None else distribution
        check_kind("distribution", distribution, self.distribution_class)
        self.distribution: Any = distribution
        # copies: SB3's VecNormalize changes the space that it is given, and spaces hold generators
        self.observation_space = deepcopy(self.episodes_class.observation_space)
        self.action_space = deepcopy(self.episodes_class.action_space)
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

    def validate_actions(
        self, actions: Any, shape: tuple[int, ...] | None, what: str
    ) -> npt.NDArray[Any]:
        """Return finite actions of this shape as an array.

        Raises:
            UserError: If they are of another shape or not finite numbers.
        """
        array = validate_shape(actions, shape, what, what.removeprefix("an "))
        if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
            raise UserError(f"Expected {what} of finite numbers, got {actions}.")
        return array

    def begin(
        self,
        i: int,
        seed: int | None,  # noqa: ARG002
        rng: np.random.Generator,
        *,
        autoreset: bool = False,  # noqa: ARG002
    ) -> None:
        """Begin another episode in place i, from a start that `rng` draws."""
        start = self.distribution.draw(rng)
        if self._episodes is not None:
            self._episodes.begin(i, start)
            return
        self._waiting[i] = start
        if len(self._waiting) == self.count:
            self._episodes = self._begin([self._waiting[k] for k in range(self.count)])

    def step(
        self,
        actions: npt.NDArray[Any],
        generators: Sequence[np.random.Generator],  # noqa: ARG002
    ) -> Transition:
        """Take finite actions (n, ...).

        Raises:
            ResetNeeded: If an episode has not begun or has ended.
        """
        if np.logical_or(*self.ended()).any():
            raise ResetNeeded("Expected reset() before step(): an episode has ended.")
        reward = self._step(self.episodes, actions)
        return Transition(reward, *self.ended(), [self.info(i) for i in range(self.count)])

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some episodes, each key (len(which), ...)."""
        return self.episodes.observe(which)

    def render(self, which: Indices) -> Bytes:
        """Draw frames of some episodes, (len(which), rows, columns, 3)."""
        return self.episodes.render(which)

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes, self._waiting = None, {}

    def _begin(self, starts: Sequence[Any]) -> EpisodesT:
        episodes: Any = self.episodes_class
        begun: EpisodesT = episodes(starts)
        return begun

    @abstractmethod
    def _step(self, episodes: EpisodesT, actions: npt.NDArray[Any]) -> Floats:
        """Take a step in each episode, and give the rewards, (n,)."""

    @abstractmethod
    def ended(self) -> tuple[Bools, Bools]:
        """Say where an episode is terminated, and where it is truncated: (n,) each."""

    @abstractmethod
    def info(self, i: int) -> dict[str, Any]:
        """Return the info of episode i."""


class TaskEnv(LockstepEnv[Batch]):
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
        super().__init__(self.task, render_mode)


class TaskVectorEnv(LockstepVectorEnv[Batch]):
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
        self.task = self.task_class(distribution, num_envs)
        super().__init__(self.task, render_mode)
