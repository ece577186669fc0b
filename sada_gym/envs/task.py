"""Inner tasks, on which agents are trained, as Gymnasium environments: one, or many in lockstep."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from sada_gym.application import Frame
from sada_gym.envs.checks import (
    check_reset_options,
    checked_actions,
    checked_render_mode,
    checked_seed,
    warn_without_render_mode,
)
from sada_gym.envs.vector import SeededVectorEnv

Observation = dict[str, npt.NDArray[Any]]

_FIRST = np.zeros(1, np.intp)


class Lessons(Protocol):
    """Episodes in lockstep, with what each step is worth: for scalar and vector alike.

    Attributes:
        observation_space: Of one episode.
        action_space: Of one episode.
    """

    observation_space: spaces.Dict
    action_space: spaces.Box[Any]

    def start(self, i: int, rng: np.random.Generator) -> None:
        """Begin another episode in place i."""

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Take finite actions (n, ...), and give what that was worth, (n,).

        Raises:
            ResetNeeded: If an episode has not begun or has ended.
        """

    def over(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Where an episode is terminated, and where truncated: (n,) each."""

    def info(self, i: int) -> dict[str, Any]:
        """How episode i stands."""

    def observe(self, which: npt.NDArray[np.intp]) -> Observation:
        """What the agents of some episodes perceive, (len(which), ...)."""

    def look(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8]:
        """Draw some episodes, (len(which), rows, columns, 3)."""

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""


class TaskEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """One lesson at a time.

    Args:
        lessons: Room for one.
        render_mode: Among those of the class's `metadata`.
    """

    def __init__(self, lessons: Lessons, *, render_mode: str | None) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        # copies: SB3's VecNormalize changes the space that it is given, and spaces hold generators
        self.observation_space: spaces.Dict = deepcopy(lessons.observation_space)  # type: ignore[assignment]
        self.action_space = deepcopy(lessons.action_space)
        self._lessons = lessons

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Set off anew."""
        check_reset_options(options)
        super().reset(seed=checked_seed(seed))
        self._lessons.start(0, self.np_random)
        return self._observation(), self._lessons.info(0)

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Go on for one decision's time."""
        reward = self._lessons.step(checked_actions(action, self.action_space, "an action")[None])
        terminated, truncated = self._lessons.over()
        info = self._lessons.info(0)
        return self._observation(), float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Frame | None:
        """Give the camera's picture."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        frame: Frame = self._lessons.look(_FIRST)[0]
        return frame

    def close(self) -> None:
        """Free what the lesson holds; doing it again is fine."""
        self._lessons.close()

    def _observation(self) -> Observation:
        return {key: value[0] for key, value in self._lessons.observe(_FIRST).items()}


class TaskVectorEnv(SeededVectorEnv[Observation]):
    """Lessons in lockstep: equals `SyncVectorEnv` of `TaskEnv` with `AutoresetMode.SAME_STEP`.

    Args:
        lessons: Room for `num_envs`.
        num_envs: Number of environments.
        render_mode: Among those of the class's `metadata`.
    """

    def __init__(self, lessons: Lessons, *, num_envs: int, render_mode: str | None) -> None:
        self._lessons = lessons  # first: older Gymnasiums close what was refused
        super().__init__(num_envs=num_envs, render_mode=render_mode)
        self.single_observation_space: spaces.Dict = deepcopy(lessons.observation_space)
        self.single_action_space = deepcopy(lessons.action_space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._everyone = np.arange(num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Set off anew, all or those in the boolean array `options["reset_mask"]`.

        Args:
            seed: An int (environment i gets seed + i) or a sequence of one seed an environment.
            options: `reset_mask`, (num_envs,) bool, where only some are to be reset.
        """
        for i, _ in self._reseeded(seed, options):
            self._lessons.start(i, self._generators[i])
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            infos = self._add_info(infos, self._lessons.info(i), i)
        return self._lessons.observe(self._everyone), infos

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Observation,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Go on for one decision's time; who has ended sets off anew."""
        reward = self._lessons.step(checked_actions(actions, self.action_space, "actions"))
        terminated, truncated = self._lessons.over()
        over = np.flatnonzero(terminated | truncated)
        last = self._lessons.observe(over)
        infos: dict[str, Any] = {}
        for i in self._everyone.tolist():
            info = self._lessons.info(i)
            if terminated[i] or truncated[i]:
                row = int(np.searchsorted(over, i))
                seen = {key: value[row] for key, value in last.items()}
                infos = self._add_info(infos, {"final_obs": seen, "final_info": info}, i)
                self._lessons.start(i, self._generators[i])
                info = self._lessons.info(i)
            infos = self._add_info(infos, info, i)
        observation = self._lessons.observe(self._everyone)
        return observation, reward, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Give each camera's picture."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return tuple(self._lessons.look(self._everyone))

    def close_extras(self, **_: Any) -> None:
        """Free what the lessons hold."""
        self._lessons.close()
