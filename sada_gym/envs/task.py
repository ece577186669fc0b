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
from sada_gym.envs.checks import checked_actions, checked_render_mode, warn_without_render_mode
from sada_gym.envs.vector import SeededVectorEnv
from sada_gym.resets import check_reset_options, checked_seed

Observation = dict[str, npt.NDArray[Any]]

_FIRST = np.zeros(1, np.intp)


class TaskEpisodes(Protocol):
    """Episodes of an inner task in lockstep, with their rewards: for scalar and vector alike.

    Attributes:
        observation_space: Of one episode.
        action_space: Of one episode.
    """

    observation_space: spaces.Dict
    action_space: spaces.Box[Any]

    def start(self, i: int, rng: np.random.Generator) -> None:
        """Begin another episode in place i."""

    def step(self, actions: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Take finite actions (n, ...), and give the rewards, (n,).

        Raises:
            ResetNeeded: If an episode has not begun or has ended.
        """

    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Where an episode is terminated, and where truncated: (n,) each."""

    def info(self, i: int) -> dict[str, Any]:
        """The info of episode i."""

    def observe(self, which: npt.NDArray[np.intp]) -> Observation:
        """Observations of some episodes, (len(which), ...)."""

    def render(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8]:
        """Frames of some episodes, (len(which), rows, columns, 3)."""

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""


class TaskEnv(gym.Env[Observation, npt.NDArray[Any]]):
    """One episode of an inner task at a time.

    Args:
        episodes: Room for one.
        render_mode: Among those of the class's `metadata`.
    """

    def __init__(self, episodes: TaskEpisodes, *, render_mode: str | None) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        # copies: SB3's VecNormalize changes the space that it is given, and spaces hold generators
        self.observation_space: spaces.Dict = deepcopy(episodes.observation_space)  # type: ignore[assignment]
        self.action_space = deepcopy(episodes.action_space)
        self._episodes = episodes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin another episode."""
        check_reset_options(options)
        super().reset(seed=checked_seed(seed))
        self._episodes.start(0, self.np_random)
        return self._observation(), self._episodes.info(0)

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take one action."""
        reward = self._episodes.step(checked_actions(action, self.action_space, "an action")[None])
        terminated, truncated = self._episodes.ended()
        info = self._episodes.info(0)
        return self._observation(), float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Frame | None:
        """Give the camera's image."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        frame: Frame = self._episodes.render(_FIRST)[0]
        return frame

    def close(self) -> None:
        """Free what the episode holds; doing it again is fine."""
        self._episodes.close()

    def _observation(self) -> Observation:
        return {key: value[0] for key, value in self._episodes.observe(_FIRST).items()}


class TaskVectorEnv(SeededVectorEnv[Observation]):
    """Episodes in lockstep: equals `SyncVectorEnv` of `TaskEnv` with `AutoresetMode.SAME_STEP`.

    Args:
        episodes: Room for `num_envs`.
        num_envs: Number of environments.
        render_mode: Among those of the class's `metadata`.
    """

    def __init__(self, episodes: TaskEpisodes, *, num_envs: int, render_mode: str | None) -> None:
        self._episodes = episodes  # first: older Gymnasiums close what was refused
        super().__init__(num_envs=num_envs, render_mode=render_mode)
        self.single_observation_space: spaces.Dict = deepcopy(episodes.observation_space)
        self.single_action_space = deepcopy(episodes.action_space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._everyone = np.arange(num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin other episodes, all or those in the boolean array `options["reset_mask"]`.

        Args:
            seed: An int (environment i gets seed + i) or a sequence of one seed an environment.
            options: `reset_mask`, (num_envs,) bool, where only some are to be reset.
        """
        for i, _ in self._reseeded(seed, options):
            self._episodes.start(i, self._generators[i])
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            infos = self._add_info(infos, self._episodes.info(i), i)
        return self._episodes.observe(self._everyone), infos

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[
        Observation,
        npt.NDArray[np.float64],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Take one action each; where an episode ends, another begins."""
        reward = self._episodes.step(checked_actions(actions, self.action_space, "actions"))
        terminated, truncated = self._episodes.ended()
        ended = np.flatnonzero(terminated | truncated)
        last = self._episodes.observe(ended)
        infos: dict[str, Any] = {}
        for i in self._everyone.tolist():
            info = self._episodes.info(i)
            if terminated[i] or truncated[i]:
                row = int(np.searchsorted(ended, i))
                final = {key: value[row] for key, value in last.items()}
                infos = self._add_info(infos, {"final_obs": final, "final_info": info}, i)
                self._episodes.start(i, self._generators[i])
                info = self._episodes.info(i)
            infos = self._add_info(infos, info, i)
        observation = self._episodes.observe(self._everyone)
        return observation, reward, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Give each camera's image."""
        if self.render_mode is None:
            warn_without_render_mode()
            return None
        return tuple(self._episodes.render(self._everyone))

    def close_extras(self, **_: Any) -> None:
        """Free what the episodes hold."""
        self._episodes.close()
