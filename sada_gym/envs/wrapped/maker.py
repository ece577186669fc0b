"""Makes the environment under attack: by its id or by a user's function, fresh for each episode."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator
from gymnasium.wrappers import TimeLimit

from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.ids import find_spec

EnvLike = str | Callable[..., gym.Env[Any, Any]]
"""An environment's id, `module:id`, or a function that makes one."""

_NOT_PHYSICS = ("self", "render_mode")


@dataclass(frozen=True)
class Maker:
    """Makes environments.

    Attributes:
        environment: The environment's id, `module:id`, or a function that makes one.
        env_kwargs: The keywords that every environment gets.
        max_steps: The limit of steps; None keeps the environment's own.

    Raises:
        UserError: If there is no such environment, or it does not take the keywords.
    """

    environment: EnvLike
    env_kwargs: Mapping[str, Any]
    max_steps: int | None

    def __post_init__(self) -> None:
        """Check the environment's name and the keywords' names."""
        if not isinstance(self.environment, str) and not callable(self.environment):
            raise UserTypeError(
                "Expected an environment's id, or a function that makes an environment, got "
                f"{self.environment!r}. Pass 'CartPole-v1', or make_my_env without brackets."
            )
        if not isinstance(self.env_kwargs, Mapping):
            raise UserTypeError(f"Expected env_kwargs to be a dictionary, got {self.env_kwargs!r}.")
        if "render_mode" in self.env_kwargs:
            raise UserError(
                "Expected env_kwargs without render_mode, which is chosen where pictures are drawn."
            )
        if not self.takes_any_keyword:
            check_known(f"keyword of {self.name}", self.env_kwargs, self.keywords)

    @property
    def name(self) -> str:
        """The environment's id without its module, or the function's name."""
        if isinstance(self.environment, str):
            return self.environment.rpartition(":")[2]
        made_by: Any = self.environment
        while isinstance(made_by, partial):
            made_by = made_by.func
        return str(getattr(made_by, "__name__", type(made_by).__name__))

    @property
    def identity(self) -> str:
        """What settings call the environment."""
        return (
            self.environment if isinstance(self.environment, str) else code_name(self.environment)
        )

    @property
    def keywords(self) -> list[str]:
        """The named keywords of the environment's constructor, without `render_mode`."""
        named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        return [
            name
            for name, parameter in self._signature.items()
            if parameter.kind in named and name not in _NOT_PHYSICS
        ]

    @property
    def takes_render_mode(self) -> bool:
        """Whether the constructor takes `render_mode`."""
        return "render_mode" in self._signature or self.takes_any_keyword

    def make(
        self, keywords: Mapping[str, Any], render_mode: str | None = None
    ) -> gym.Env[Any, Any]:
        """Make a fresh environment.

        Args:
            keywords: The keywords of this one, besides those that all get.
            render_mode: How it renders, if at all.

        Raises:
            UserError: If its constructor raises, or makes no environment.
        """
        # copies: an environment may write into a dictionary that it is given
        given = {**deepcopy(dict(self.env_kwargs)), **keywords}
        if render_mode is not None:
            given["render_mode"] = render_mode
        try:
            if isinstance(self.environment, str):
                if self.max_steps is not None:
                    given["max_episode_steps"] = self.max_steps
                spec = find_spec(self.environment)
                made: Any = gym.make(spec, disable_env_checker=True, **given)
            else:
                made = self.environment(**given)
        except UserError:
            raise
        except Exception as error:  # whatever an environment's constructor may raise
            found = f"got {type(error).__name__}: {error}"
            if isinstance(error, ImportError):
                raise self._lacking(error) from error
            hint = (
                " Narrow the ranges to what it takes; write Keyword(low, high, integer=True) for a "
                "whole number."
            )
            raise UserError(
                f"Expected {self.name} to be made with {given}, {found}.{hint if keywords else ''}"
            ) from error
        if not isinstance(made, gym.Env):
            raise UserTypeError(
                f"Expected {self.name} to make a gymnasium.Env, got {type(made).__name__}. Return "
                "the environment from the function."
            )
        return made

    def _lacking(self, error: ImportError) -> UserError:
        return UserError(
            f"Expected the packages that {self.name} needs, got {type(error).__name__}: {error}. "
            "Install what it names."
        )

    @property
    def _signature(self) -> Mapping[str, inspect.Parameter]:
        creator: Any = self.environment
        if isinstance(creator, str):
            creator = find_spec(creator).entry_point
            if creator is None:
                raise UserError(
                    f"Expected an environment of single episodes, got {self.name}, which exists "
                    "as a vector environment only. Pass a function that makes one."
                )
        if isinstance(creator, str):
            try:
                creator = load_env_creator(creator)
            except ImportError as error:
                raise self._lacking(error) from error
        try:
            return inspect.signature(creator).parameters
        except ValueError:  # it is written in C
            return {}

    @property
    def takes_any_keyword(self) -> bool:
        """Whether the constructor takes keywords that its signature does not name."""
        return any(one.kind is one.VAR_KEYWORD for one in self._signature.values())


def code_name(function: Callable[..., Any]) -> str:
    """Name a function or an object of a class by its module and its qualified name."""
    if isinstance(function, partial):
        held = [*function.args, *(f"{key}={one!r}" for key, one in function.keywords.items())]
        return f"{code_name(function.func)}({', '.join(map(str, held))})"
    named = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}:{named.__qualname__}"


def layers(env: gym.Env[Any, Any]) -> Iterator[gym.Env[Any, Any]]:
    """Give an environment's wrappers from the outside in, and at last the environment itself."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
    yield env


def own_limit(env: gym.Env[Any, Any]) -> bool:
    """Say whether an environment's wrappers end its episodes after some number of steps."""
    return any(isinstance(layer, TimeLimit) for layer in layers(env))
