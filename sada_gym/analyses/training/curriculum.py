"""A wrapper for training: each episode takes place in a world where the agent fails, or another."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from sada_gym.analyses.training.mixture import FAILURES, DrawnWorld, WorldMixture
from sada_gym.analyses.training.tasks import KINDS, TaskWorlds, task_of
from sada_gym.analyses.training.worlds import GymnasiumWorlds, NoAgent
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import InvalidWorld, UserError, UserTypeError
from sada_gym.experiment.names import card_of
from sada_gym.foundations.cards import cards
from sada_gym.foundations.ids import find_spec, names_file
from sada_gym.foundations.resets import validate_seed

_TRIED = 20
"""Worlds that may break in a row at their reset."""


class FailureCurriculum(gym.Wrapper[Any, Any, Any, Any]):
    """Draws the world of each episode: a failure of the agent, a uniform or a nominal world.

    Observations, actions and rewards are those of the environment, so that it works with any
    training script. Put your wrappers around it, or into the function that makes the environment.
    The infos of a reset and of the last step of an episode have `curriculum`: the `source`, and (if
    the world has one) `mu` and the physical `parameters`. Copied and unpickled environments need a
    reset. They draw other worlds than the original, unless the reset has the same seed.

    Args:
        environment: A TOML file or a `GymnasiumApplication`, whose agent is not used; the id or the
            environment of a shipped task (`SADA-RobotTask-v0`, `SADA-DrivingTask-v0`, or an id that
            is attacked, such as `SADA-Robot-v0`); or your own environment with `set_mu` and
            `space`, see `Worlds`.
        source: Where failures come from: the folder of a run (its adversary draws new ones); an
            adversary; a suite; `failures(RUN)`, the failures in the run; `weaknesses(RUN)`, worlds
            in the weaknesses of its diagnosis; an array of mu, (n, d); or several of these by name.
        shares: The share of episodes by source: `failures` (or the names of your sources),
            `uniform` and `nominal`. They sum to 1. By default, half of the episodes are failures, a
            quarter is uniform and a quarter nominal.
        render_mode: The environment's render mode; omit it if you pass an environment.

    Raises:
        UserError: If the environment is none of these, or for the reasons of `WorldMixture`.

    Example:
        >>> env = make_vec_env(lambda: FailureCurriculum("pole.toml", "runs/pole"), n_envs=8)
        >>> PPO.load("pole.zip", env=env).learn(100_000).save("fixed.zip")
    """

    def __init__(
        self,
        environment: str | Path | GymnasiumApplication | gym.Env[Any, Any],
        source: Any = None,
        *,
        shares: Mapping[str, float] | None = None,
        render_mode: str | None = None,
    ) -> None:
        worlds: Any = _worlds(environment, render_mode)
        super().__init__(worlds)
        self._worlds = worlds
        self.mixture = WorldMixture(worlds.get_wrapper_attr("space"), source, shares)
        self.world: DrawnWorld | None = None
        self._rng: np.random.Generator | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the generator: copies do not draw the same worlds."""
        return {**self.__dict__, "_rng": None, "world": None}

    @property
    def spec(self) -> None:  # type: ignore[override]
        """None: no specification could make its worlds again."""
        return

    def set_source(
        self, source: Any, name: str = FAILURES, shares: Mapping[str, float] | None = None
    ) -> None:
        """Use another source of failures from the next reset on.

        In Stable-Baselines3, `env_method("set_source", "runs/second")` reaches all environments.

        Args:
            source: A source as in the constructor.
            name: The name of the source to replace; a new name adds a source.
            shares: New shares; None keeps those that were given.

        Raises:
            UserError: As the constructor does. Then nothing changes.
        """
        self.mixture.set_source(source, name, shares)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in a new world; `options` go to the environment.

        A seed, any int from 0 up, fixes this world and all later ones.
        """
        seed = validate_seed(seed)
        if seed is not None or self._rng is None:
            self._rng = np.random.default_rng(seed)
        for _ in range(_TRIED):
            world = self.mixture.draw(self._rng)
            self._worlds.get_wrapper_attr("set_mu")(world.mu)
            try:
                observation, info = self.env.reset(
                    seed=int(self._rng.integers(2**31)), options=options
                )
            except InvalidWorld as error:
                broken = error
                continue
            self.world = world
            return observation, {**info, **self._told()}
        raise UserError(
            f"Expected worlds that can be computed, but {_TRIED} in a row broke. The last one: "
            f"{broken}"
        ) from broken

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take an action."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            info = {**info, **self._told()}
        return observation, reward, terminated, truncated, info

    def _told(self) -> dict[str, Any]:
        if self.world is None:
            return {}
        told: dict[str, Any] = {"source": self.world.source}
        if self.world.mu is not None:
            told["mu"] = self.world.mu.copy()
            told["parameters"] = self.mixture.space.parameters.describe(self.world.mu)
        return {"curriculum": told}


def _worlds(environment: Any, render_mode: str | None) -> gym.Env[Any, Any]:
    """Return the environment in which worlds are set by mu."""
    if isinstance(environment, gym.vector.VectorEnv):
        raise UserTypeError(
            f"Expected an environment of single episodes, got {environment}. Wrap the "
            "environments before they are put together, or take curriculum_vec_env."
        )
    if isinstance(environment, gym.Env):
        if render_mode is not None:
            raise UserError(
                "Expected no render_mode beside an environment, got "
                f"{render_mode!r}. Make the environment with it."
            )
        if environment.has_wrapper_attr("set_mu") and environment.has_wrapper_attr("space"):
            return environment
        name = task_of(environment)
        if name is None:
            raise UserError(
                f"Expected an environment whose worlds can be set by mu, got {environment}. Pass "
                "a TOML file or a GymnasiumApplication, which say what mu sets."
            )
        return TaskWorlds(environment, name)
    if isinstance(environment, GymnasiumApplication):
        return GymnasiumWorlds(environment, render_mode=render_mode)
    if isinstance(environment, Path) or (isinstance(environment, str) and names_file(environment)):
        described = read_application(environment, agent=NoAgent())
        if not isinstance(described, GymnasiumApplication):
            raise UserError(f"Expected an environment to train in, got images in {environment}.")
        return GymnasiumWorlds(described, render_mode=render_mode)
    if isinstance(environment, str):
        env_id, name = task_id(environment)
        return TaskWorlds(gym.make(env_id, render_mode=render_mode), name)
    raise UserTypeError(
        "Expected a TOML file, a GymnasiumApplication, an id of ours or an environment to train "
        f"in, got {environment!r}."
    )


def task_id(given: str) -> tuple[str, str]:
    """Return the id of the task that an id means, its own or one that is attacked, and its name.

    Raises:
        UserError: If it is neither, or has no worlds to train in.
    """
    spec = find_spec(given)
    card = card_of(given)
    card = card or next((card for card in cards() if spec.id in card.tasks), None)
    if card is None or card.name not in KINDS:
        known = ", ".join(f"{name}-v0" for name in KINDS)
        raise UserError(
            f"Expected a TOML file, a GymnasiumApplication or an id whose agents can be trained "
            f"({known}), got {given!r}. An id alone does not say what mu sets: write a file by "
            f"`sada-gym init {given}`."
        )
    return next(iter(card.tasks)), card.name
