"""Makes the environment under attack: by its id or by a user's function, fresh for each episode."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal
from weakref import WeakSet

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator
from gymnasium.wrappers import TimeLimit

from sada_gym.envs.wrapped.served import ServedEnvironment
from sada_gym.errors import (
    UserError,
    UserTypeError,
    WorkerError,
    broken_world,
    check_known,
    described,
)
from sada_gym.foundations.ids import find_spec, receive_spec, sent_spec

EnvLike = str | Callable[..., gym.Env[Any, Any]]
"""An environment's id, `module:id`, or a function that makes one."""

KEEPERS: WeakSet[Any] = WeakSet()
"""What keeps environments between episodes, in this process; `close` ends these."""

_NOT_PHYSICS = ("self", "render_mode")


@dataclass(frozen=True)
class EnvFactory:
    """Makes environments: by an id, or by a function.

    `env_kwargs` go to every environment; `max_steps` None keeps the environment's own limit, and
    "own" says that it ends its episodes by itself, although no wrapper shows it. Where `num_envs`
    limits how many may be alive, those that are kept are closed before one is made. It raises
    `UserError` if there is no such environment, or it does not take the keywords.
    """

    environment: EnvLike
    env_kwargs: Mapping[str, Any]
    max_steps: int | Literal["own"] | None
    num_envs: int | None = None

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
                "Expected env_kwargs without render_mode: pictures and videos choose it themselves."
            )
        if not self.takes_any_keyword:
            check_known(f"keyword of {self.name}", self.env_kwargs, self.keywords)

    def __getstate__(self) -> dict[str, Any]:
        """Take an id's specification along: a worker may not have run the script with it."""
        return {**self.__dict__, "sent": sent_spec(self.environment)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Register the id."""
        receive_spec(state.pop("sent"))
        self.__dict__.update(state)

    @property
    def name(self) -> str:
        """The environment's id without its module, or the function's name."""
        if isinstance(self.environment, str):
            return self.environment.rpartition(":")[2]
        function: Any = self.environment
        while isinstance(function, partial):
            function = function.func
        return str(getattr(function, "__name__", type(function).__name__))

    @property
    def identity(self) -> str:
        """The environment's id, or the function's module and qualified name, for settings."""
        given = self.environment
        if isinstance(given, ServedEnvironment):
            return f"served:{self.name}"
        return given if isinstance(given, str) else code_name(given)

    @property
    def keywords(self) -> list[str]:
        """The named keywords of the environment's constructor, without `render_mode`."""
        named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        return [
            name
            for name, parameter in self.parameters.items()
            if parameter.kind in named and name not in _NOT_PHYSICS
        ]

    @property
    def takes_any_keyword(self) -> bool:
        """Whether the constructor takes keywords that its signature does not name."""
        parameters = self.parameters.values()
        return any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)

    @property
    def takes_render_mode(self) -> bool:
        """Whether the constructor takes `render_mode`."""
        return "render_mode" in self.parameters or self.takes_any_keyword

    def step_limit(self, env: gym.Env[Any, Any]) -> int | None:
        """Return the most steps that episodes of its environments have; None if it is unknown."""
        limits = [layer._max_episode_steps for layer in layers(env) if isinstance(layer, TimeLimit)]
        return min(limits, default=None)

    def make(
        self, keywords: Mapping[str, Any], render_mode: str | None = None
    ) -> gym.Env[Any, Any]:
        """Make a fresh environment, with keywords besides `env_kwargs`.

        It raises `UserError` if its constructor raises, or makes no environment.
        """
        for keeper in [] if self.num_envs is None else [*KEEPERS]:
            keeper.close()
        # copies: an environment may write into a dictionary that it is given
        all_keywords = {**deepcopy(dict(self.env_kwargs)), **keywords}
        by_id = isinstance(self.environment, str | ServedEnvironment)
        if render_mode is not None:
            all_keywords["render_mode"] = render_mode
        limit = None if self.max_steps == "own" else self.max_steps
        if by_id and limit is not None:
            all_keywords["max_episode_steps"] = limit
        fix = (
            "Narrow the ranges to what it takes; write Keyword(low, high, integer=True) for a "
            "whole number."
        )
        try:
            env: Any = self._creator(**all_keywords)
        except (UserError, WorkerError):
            raise
        except ImportError as error:
            raise self._missing_package(error) from error
        except (Exception, SystemExit) as error:  # whatever a constructor may raise
            expected = f"Expected {self.name} to be made with {all_keywords}"
            fix = fix if keywords else ""
            raise broken_world("its constructor", error, expected, fix) from error
        if not isinstance(env, gym.Env):
            raise UserTypeError(
                f"Expected {self.name} to make a gymnasium.Env, got {type(env).__name__}. Return "
                "the environment from the function."
            )
        return env if by_id or limit is None else TimeLimit(env, int(limit))

    @property
    def _creator(self) -> Callable[..., Any]:
        if isinstance(self.environment, str):
            return partial(gym.make, find_spec(self.environment), disable_env_checker=True)
        return self.environment

    def _missing_package(self, error: ImportError) -> UserError:
        return UserError(
            f"Expected the packages that {self.name} needs, got {described(error)}. "
            "Install what it names."
        )

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        """What the environment's constructor takes, `render_mode` included."""
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
                raise self._missing_package(error) from error
        try:
            return inspect.signature(creator).parameters
        except ValueError:  # it is written in C
            return {}

    @property
    def defaults(self) -> dict[str, Any]:
        """The values of keywords that nobody gives: those of the id, and of the signature."""
        own = {
            name: parameter.default
            for name, parameter in self.parameters.items()
            if parameter.default is not parameter.empty
        }
        by_id = find_spec(self.environment).kwargs if isinstance(self.environment, str) else {}
        return {**own, **by_id}


def function_name(function: Any) -> str:
    """Return the name of a function, or that of an object's class."""
    return str(getattr(function, "__name__", type(function).__name__))


def code_name(function: Callable[..., Any]) -> str:
    """Return the module and the qualified name of a function, or of an object's class."""
    if isinstance(function, partial):
        keywords = [f"{key}={value!r}" for key, value in function.keywords.items()]
        return f"{code_name(function.func)}({', '.join([*map(str, function.args), *keywords])})"
    named = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}:{named.__qualname__}"


def has_time_limit(env: gym.Env[Any, Any]) -> bool:
    """Return whether a `TimeLimit` ends an environment's episodes."""
    return any(isinstance(layer, TimeLimit) for layer in layers(env))


def layers(env: gym.Env[Any, Any]) -> Iterator[gym.Env[Any, Any]]:
    """Iterate over an environment's wrappers from the outside in, and at last the environment."""
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
    yield env
