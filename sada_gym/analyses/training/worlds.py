"""Environments to train in, whose next world is set by mu."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from sada_gym.densities import WorldDensity
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.errors import InvalidWorld
from sada_gym.foundations.arrays import Floats32
from sada_gym.parameters import ParameterSpace, Permits, all_can_exist


@dataclass(frozen=True, eq=False)
class WorldSpace:
    """The worlds that an environment can make.

    Attributes:
        name: The application's name, such as `SADA-Robot`; empty if it has none.
        parameters: The parameters that mu sets.
        nominal: The mu of the nominal world, (d,); None if that is the environment as it is,
            without a mu.
        density: How likely worlds are in ordinary use; None if it is unknown.
        permits: A function that returns which worlds of mu, (n, d), can exist, as (n,) bool.
    """

    name: str
    parameters: ParameterSpace
    nominal: Floats32 | None = None
    density: WorldDensity | None = None
    permits: Permits = all_can_exist


class Worlds(Protocol):
    """What your own environment needs, without wrappers: `space`, and `set_mu` to set the world."""

    @property
    def space(self) -> WorldSpace:
        """The worlds that it can make."""
        ...

    def set_mu(self, mu: Floats32 | None) -> None:
        """Set mu, (d,), for episodes from the next reset on; None: the environment as it is."""


class NoAgent:
    """Stands where an application has its agent: nobody acts there but who is trained."""

    fingerprint = None

    def start(self, count: int) -> None:  # noqa: ARG002
        """Raise an error."""
        raise RuntimeError("Expected an agent to evaluate, got an application for training.")

    def act(self, episodes: Any, which: Any) -> Any:  # noqa: ARG002
        """Raise an error."""
        self.start(0)


class GymnasiumWorlds(gym.Env[Any, Any]):
    """Any Gymnasium environment, fresh in each episode, with its parameters and disturbances set.

    An episode is played in exactly the world of an evaluation with the same mu and seed. Where a
    world breaks in mid-episode, the episode is truncated, and its last info says why as `invalid`.
    Its disturbances belong to the world: nobody sees them as wrappers that an agent would need.

    Args:
        application: Says what mu sets; its agent does not matter.
        render_mode: The environment's.
    """

    def __init__(
        self, application: GymnasiumApplication, *, render_mode: str | None = None
    ) -> None:
        self._application = bare = copy(application)
        bare.agent = bare.policy = NoAgent()
        self.space = WorldSpace(
            bare.name, bare.parameters, bare.nominal, bare.density, bare.permits
        )
        self.render_mode = render_mode
        self.observation_space = bare.episode_spec.observation_space
        self.action_space = bare.episode_spec.action_space
        self._mu: Floats32 | None = None
        self._last: Any = None
        self._episode = self._as_it_is()
        self.metadata = self._episode.metadata

    def _as_it_is(self) -> gym.Env[Any, Any]:
        return self._application.world(None, 0, render_mode=self.render_mode)[0]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the episode, which lives in its process."""
        return {**self.__dict__, "_episode": None, "_last": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Wait for a reset."""
        self.__dict__.update(state)
        self._episode = self._as_it_is()

    @property
    def unwrapped(self) -> gym.Env[Any, Any]:
        """The environment that was made, without wrappers and disturbances."""
        return self._episode.unwrapped

    def has_wrapper_attr(self, name: str) -> bool:
        """Say whether it or the environment has an attribute, such as `action_masks`."""
        return super().has_wrapper_attr(name) or self._episode.has_wrapper_attr(name)

    def get_wrapper_attr(self, name: str) -> Any:
        """Return an attribute, its own or the environment's."""
        own = super().has_wrapper_attr(name)
        return super().get_wrapper_attr(name) if own else self._episode.get_wrapper_attr(name)

    def set_mu(self, mu: Floats32 | None) -> None:
        """Set the world, see `Worlds`."""
        self._mu = mu

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Make the world, and begin an episode in it; raise `InvalidWorld` if it breaks.

        The seed is an evaluation's, below 2**31; None draws one.
        """
        seed = int(np.random.SeedSequence().generate_state(1)[0]) >> 1 if seed is None else seed
        self._episode.close()
        self._episode, arguments = self._application.world(
            self._mu, seed, options=options, render_mode=self.render_mode
        )
        self._last, info = self._episode.reset(**arguments)
        return self._last, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action."""
        try:
            self._last, reward, terminated, truncated, info = self._episode.step(action)
        except InvalidWorld as error:
            return self._last, 0.0, False, True, {"invalid": error.reason}
        return self._last, float(reward), bool(terminated), bool(truncated), info

    def render(self) -> Any:
        """Draw a frame as the environment does."""
        return self._episode.render()

    def close(self) -> None:
        """Close the environment; doing it again is fine."""
        self._episode.close()
