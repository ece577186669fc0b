"""Gymnasium environments of episodes in lockstep: a scalar environment is a batch of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from sada_gym.errors import UserError, check_integer
from sada_gym.foundations.arrays import Bools, Floats, Indices, validate_shape
from sada_gym.foundations.frames import Frame
from sada_gym.foundations.resets import check_reset_options, reset_mask, spread_seeds, validate_seed

MAX_ENVS = 2**20
"""Environments in one batch. Each keeps a generator, some kilobytes."""

SAME_STEP: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
"""What the metadata of every batch adds to that of its scalar environment."""

_FIRST = np.zeros(1, np.intp)

Observed = TypeVar("Observed")


class RenderModes(list[str]):
    """The render modes of an environment; anything but a string counts as one of them.

    `gymnasium.make` fails on such a mode before the environment can say what it expected.
    """

    def __contains__(self, mode: object) -> bool:
        """Say whether a mode is known, or is no string."""
        return not isinstance(mode, str) or super().__contains__(mode)


class Transition(NamedTuple):
    """What a step of n episodes gives: three arrays (n,) and n dictionaries."""

    reward: Floats
    terminated: Bools
    truncated: Bools
    infos: Sequence[dict[str, Any]]


class Lockstep(ABC, Generic[Observed]):
    """The episodes of n environments, 1 to `MAX_ENVS`; one after another takes place in each.

    The spaces are those of one environment.
    """

    action_space: gym.Space[Any]
    observation_space: gym.Space[Any]

    def __init__(self, count: int) -> None:
        check_integer("num_envs", count, 1, MAX_ENVS)
        self.count = count

    def fold_seed(self, seed: int) -> int:
        """Return the seed that a reset with this seed means."""
        return seed

    def validate_actions(
        self, actions: Any, shape: tuple[int, ...] | None, what: str
    ) -> npt.NDArray[Any]:
        """Return actions of this shape as an array, else raise `UserError`, which says `what`."""
        return validate_shape(actions, shape, what)

    @abstractmethod
    def begin(
        self, i: int, seed: int | None, rng: np.random.Generator, *, autoreset: bool = False
    ) -> None:
        """Begin the next episode of environment i, after a reset or, with `autoreset`, without.

        `rng` is the environment's generator, made from the reset's seed where one was given.
        """

    @abstractmethod
    def step(
        self, actions: npt.NDArray[Any], generators: Sequence[np.random.Generator]
    ) -> Transition:
        """Take one action in each environment, (n, ...), with the environments' generators.

        Raise `ResetNeeded` if an episode has not begun or is over.
        """

    @abstractmethod
    def observe(self, which: Indices) -> Observed:
        """Return new arrays with what some environments observe, (len(which), ...) each."""

    def info(self, i: int) -> dict[str, Any]:  # noqa: ARG002
        """Return the info of a reset of environment i."""
        return {}

    def render(self, which: Indices) -> Iterable[Frame]:
        """Draw a frame of some environments."""
        raise NotImplementedError(f"{type(self).__name__} draws no pictures.")

    def close(self) -> None:
        """Free what the episodes hold; doing it again is fine."""


class LockstepEnv(gym.Env[Observed, npt.NDArray[Any]]):
    """One environment: a batch of one. The class's `metadata` names its render modes."""

    def __init__(self, lockstep: Lockstep[Observed], render_mode: str | None = None) -> None:
        self._lockstep = lockstep
        self.render_mode = _validate_render_mode(render_mode, self.metadata["render_modes"])
        self.action_space = lockstep.action_space
        self.observation_space = lockstep.observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode. The seed is an int of at least 0; there are no options."""
        check_reset_options(options)
        seed = validate_seed(seed)
        if seed is not None:
            seed = self._lockstep.fold_seed(seed)
        super().reset(seed=seed)
        self._lockstep.begin(0, seed, self.np_random)
        return self._observation(), self._lockstep.info(0)

    def step(self, action: npt.NDArray[Any]) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Take one action."""
        valid = self._lockstep.validate_actions(action, self.action_space.shape, "an action")
        reward, terminated, truncated, (info,) = self._lockstep.step(valid[None], [self.np_random])
        observation = self._observation()
        return observation, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> Frame | None:
        """Draw a frame. Without a render mode, warn and return None."""
        if self.render_mode is None:
            _warn_without_render_mode()
            return None
        (frame,) = self._lockstep.render(_FIRST)
        return frame

    def close(self) -> None:
        """Free what the environment holds; a second call does nothing."""
        self._lockstep.close()

    def _observation(self) -> Observed:
        observation: Observed = _row(self._lockstep.observe(_FIRST), 0)
        return observation


class LockstepVectorEnv(gym.vector.VectorEnv[Observed, npt.NDArray[Any], npt.NDArray[Any]]):
    """Many environments with a generator each: `SyncVectorEnv` of `LockstepEnv` in SAME_STEP mode.

    Where an episode ends, its last info and observation stand in `infos["final_info"]` and
    `infos["final_obs"]`, and the observation is the next episode's first. Some clients expect the
    `autoreset_mode` of `metadata` as an attribute.
    """

    def __init__(self, lockstep: Lockstep[Observed], render_mode: str | None = None) -> None:
        self._lockstep = lockstep
        self.num_envs = lockstep.count
        self.autoreset_mode: AutoresetMode = self.metadata["autoreset_mode"]
        self.render_mode = _validate_render_mode(render_mode, self.metadata["render_modes"])
        self.single_action_space = lockstep.action_space
        self.single_observation_space = lockstep.observation_space
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._all = np.arange(self.num_envs)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generators, one for each environment."""
        return tuple(self._generators)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode in all environments, or in those of `options["reset_mask"]`, (n,) bool.

        With a seed, an int of at least 0, environment i gets seed + i; a sequence has one for each.
        """
        seeds = spread_seeds(seed, self.num_envs)
        for i in reset_mask(options, self.num_envs):
            given = seeds[i]
            if given is not None:
                given = self._lockstep.fold_seed(given)
                self._generators[i] = seeding.np_random(given)[0]
            self._lockstep.begin(i, given, self._generators[i])
        infos: dict[str, Any] = {}
        for i in range(self.num_envs):
            infos = self._add_info(infos, self._lockstep.info(i), i)
        return self._lockstep.observe(self._all), infos

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[Observed, Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in each environment, (num_envs, ...). After an episode the next begins."""
        valid = self._lockstep.validate_actions(actions, self.action_space.shape, "actions")
        reward, terminated, truncated, last_infos = self._lockstep.step(valid, self._generators)
        over = terminated | truncated
        last = self._lockstep.observe(np.flatnonzero(over))
        place = np.cumsum(over) - 1
        infos: dict[str, Any] = {}
        for i, info in enumerate(last_infos):
            if over[i]:
                final = {"final_obs": _row(last, int(place[i])), "final_info": info}
                infos = self._add_info(infos, final, i)
                self._lockstep.begin(i, None, self._generators[i], autoreset=True)
                info = self._lockstep.info(i)
            infos = self._add_info(infos, info, i)
        return self._lockstep.observe(self._all), reward, terminated, truncated, infos

    def render(self) -> tuple[Frame, ...] | None:
        """Draw a frame of each environment. Without a render mode, warn and return None."""
        if self.render_mode is None:
            _warn_without_render_mode()
            return None
        return tuple(self._lockstep.render(self._all))

    def close_extras(self, **_: Any) -> None:
        """Free what the environments hold."""
        if hasattr(self, "_lockstep"):  # older Gymnasiums also close what was refused
            self._lockstep.close()


def _row(batch: Any, i: int) -> Any:
    return {key: value[i] for key, value in batch.items()} if isinstance(batch, dict) else batch[i]


def _validate_render_mode(render_mode: str | None, known: Sequence[str]) -> str | None:
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in known):
        raise UserError(f"Expected render_mode None or among {known}, got {render_mode!r}.")
    return render_mode


def _warn_without_render_mode() -> None:
    gym.logger.warn(
        "render() draws nothing without a render mode. Make the environment with "
        "render_mode='rgb_array'."
    )
