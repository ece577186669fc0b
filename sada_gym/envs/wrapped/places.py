"""Where a parameter's value goes: a keyword, an attribute, an option of reset, a configuration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.maker import Maker, code_name
from sada_gym.envs.wrapped.paths import MISSING, no_such_path, read, write
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.parameters import Parameter

Act = Callable[[gym.Env[Any, Any]], None]
Filter = Callable[[Any], Any]

_NAMED_VALUES = 12
"""Whole numbers are named one by one on axes where there are at most so many."""


@dataclass
class Setup:
    """How one episode begins and what surrounds its agent; each place adds to it.

    Attributes:
        maker: Makes the environment.
        observation_space: The space of the observations.
        action_space: The space of the actions.
        generator: Gives the generator of one disturbance by the parameter's name.
        keywords: Keywords of the environment's constructor.
        options: Options of its `reset`.
        before: Functions of `env.unwrapped` that are called before `reset`.
        after: Functions of `env.unwrapped` that are called after `reset`.
        sensors: What observations pass through, with the number by which they are ordered.
        actuators: What actions pass through, the same way.
        repeats: The steps for which each action of the agent acts.
    """

    maker: Maker
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]
    generator: Callable[[str], np.random.Generator]
    keywords: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    before: list[Act] = field(default_factory=list)
    after: list[Act] = field(default_factory=list)
    sensors: list[tuple[int, Filter]] = field(default_factory=list)
    actuators: list[tuple[int, Filter]] = field(default_factory=list)
    repeats: int = 1


@dataclass(frozen=True)
class Place(ABC):
    """Where a parameter's value goes.

    Attributes:
        low: The value at mu = -1.
        high: The value at mu = +1.
        unit: The unit in tables and on axes.
        choices: Values to choose from, equal parts of [-1, 1], instead of `low` and `high`.
        integer: Whether the values are the whole numbers from `low` to `high`, equal parts each.
    """

    low: float | None = None
    high: float | None = None
    unit: str = field(default="", kw_only=True)
    choices: tuple[Any, ...] = field(default=(), kw_only=True)
    integer: bool = field(default=False, kw_only=True)

    def parameter(self, name: str) -> Parameter:
        """Give the parameter of this name.

        Raises:
            UserError: If the range is empty, or no range.
        """
        if self.choices:
            if isinstance(self.choices, str) or len(self.choices) < 2:
                raise UserError(
                    f"Expected at least two choices of {name!r}, got {self.choices!r}. Write "
                    "choices=('dry', 'wet')."
                )
            if self.low is not None or self.high is not None or self.integer:
                raise UserError(
                    f"Expected either choices or low and high for {name!r}, got both. Leave low, "
                    "high and integer out."
                )
            names = tuple(map(str, self.choices))
            return Parameter(name, 0.0, float(len(names)), self.unit, choices=names)
        low, high = self._range(name)
        if not self.integer:
            return Parameter(name, low, high, self.unit)
        if low != round(low) or high != round(high):
            raise UserError(
                f"Expected whole numbers as low and high of {name!r}, which is an integer, got "
                f"{self.low} and {self.high}."
            )
        Parameter(name, low, high)  # refuses an empty range
        count = int(high - low) + 1
        named = tuple(str(int(low) + i) for i in range(count)) if count <= _NAMED_VALUES else ()
        return Parameter(name, low - 0.5, high + 0.5, self.unit, choices=named)

    def value(self, physical: float) -> Any:
        """Give what the environment gets for a physical value of the parameter."""
        if self.choices:
            return self.choices[min(int(physical), len(self.choices) - 1)]
        if self.integer:
            low, high = self._range("")
            return int(min(max(np.floor(physical + 0.5), low), high))
        return physical

    def _range(self, name: str) -> tuple[float, float]:
        ends = (self.low, self.high)
        for end in ends:
            if not is_number(end):
                raise UserTypeError(
                    f"Expected numbers as low and high of {name!r}, got {self.low!r} and "
                    f"{self.high!r}. Write low=1.0, high=2.0."
                )
        return float(ends[0]), float(ends[1])  # type: ignore[arg-type]

    @property
    def settings(self) -> dict[str, Any]:
        """The place as data for JSON."""
        found: dict[str, Any] = {"kind": type(self).__name__}
        for one in fields(self):
            value = getattr(self, one.name)
            if value != one.default:
                found[one.name] = code_name(value) if callable(value) else plain(value)
        return found

    @property
    def own_code(self) -> bool:
        """Whether it calls a function of the user's, of which nobody knows what it does."""
        return False

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Name all that it sets, for the parameter of this name; nothing where nobody knows."""
        return ()

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:  # noqa: B027
        """Check that the place exists.

        Args:
            name: The parameter's name.
            maker: Makes the environments.
            env: One of them, after a reset.

        Raises:
            UserError: If it does not.
        """

    @abstractmethod
    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Add to the beginning of an episode what sets this value."""


@dataclass(frozen=True)
class Keyword(Place):
    """A keyword of the environment's constructor.

    Attributes:
        name: The keyword; None takes the parameter's name.
    """

    name: str | None = None

    def targets(self, name: str) -> tuple[Any, ...]:
        """Name the entry."""
        return (self.name or name,)

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:  # noqa: ARG002
        """Check that the constructor takes the keyword, and that nobody else sets it."""
        keyword = self.name or name
        if not maker.takes_any_keyword:
            check_known(f"keyword of {maker.name}", [keyword], maker.keywords)
        if keyword in maker.env_kwargs:
            raise UserError(
                f"Expected {keyword!r} either among the parameters or in env_kwargs, got it in "
                "both. Leave it out of env_kwargs."
            )

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Hand the value to the constructor."""
        setup.keywords[self.name or name] = value


@dataclass(frozen=True)
class ResetOption(Place):
    """An entry of `reset(options={...})`.

    Attributes:
        name: The entry; None takes the parameter's name.
    """

    name: str | None = None

    def targets(self, name: str) -> tuple[Any, ...]:
        """Name the entry."""
        return (self.name or name,)

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Hand the value to `reset`."""
        setup.options[self.name or name] = value


@dataclass(frozen=True)
class Attribute(Place):
    """An attribute of `env.unwrapped`, set before `reset`, and after it where it changed.

    It is set before `reset` for the sake of environments that build their world there, and again
    after `reset` where that has put another value in its place. What exists only after `reset`,
    such as the lander of LunarLander, is set then. The first observation of the episode may
    have been made before.

    Attributes:
        paths: One or several paths, such as `length`, `model.opt.timestep` or
            `model.body_mass[1]`. Each gets the value; None takes the parameter's name.
    """

    paths: str | tuple[str, ...] | None = None

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:
        """Check that the attributes exist and hold single values."""
        for path in self.targets(name):
            found = read(env.unwrapped, path)
            if found is MISSING:
                raise no_such_path(name, path, maker, env)
            if callable(found):
                raise UserError(
                    f"Expected a value at {path!r} of {maker.name} for {name!r}, got a function. "
                    "Name an attribute that holds a number."
                )
            if (isinstance(found, np.ndarray) and found.ndim) or isinstance(found, list | dict):
                raise UserError(
                    f"Expected a single value at {path!r} of {maker.name}, got "
                    f"{type(found).__name__} of length {len(found)}. Name one entry, such as "
                    f"'{path}[0]'."
                )

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Set the attributes before and after `reset`."""
        for path in self.targets(name):
            setup.before.append(partial(write, path=path, value=value, must=False))
            setup.after.append(partial(write, path=path, value=value, must=True))

    def targets(self, name: str) -> tuple[str, ...]:
        """Give the paths."""
        if self.paths is None:
            return (name,)
        return (self.paths,) if isinstance(self.paths, str) else tuple(self.paths)


@dataclass(frozen=True)
class Config(Place):
    """An entry of `env.unwrapped.config`, a dictionary such as highway-env's environments have.

    It is set before `reset`.

    Attributes:
        name: The entry, with dots between the levels of nested dictionaries
            (`observation.vehicles_count`); None takes the parameter's name.
    """

    name: str | None = None

    def targets(self, name: str) -> tuple[Any, ...]:
        """Name the entry."""
        return (self.name or name,)

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:
        """Check that the entry exists."""
        config = getattr(env.unwrapped, "config", None)
        if not isinstance(config, dict):
            raise UserError(
                f"Expected {maker.name} to have a dictionary `config` for {name!r}, got "
                f"{config!r}. Name an attribute or a keyword instead."
            )
        *above, last = (self.name or name).split(".")
        for key in above:
            check_known(f"entry of the configuration of {maker.name}", [key], [*config])
            config = config[key]
        check_known(f"entry of the configuration of {maker.name}", [last], [*config])

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Write the value into a copy of the configuration."""
        *above, last = (self.name or name).split(".")

        def write(env: Any) -> None:
            env.config = config = deepcopy(env.config)
            for key in above:
                config = config[key]
            config[last] = value

        # in front: copies of the configuration follow one another, each with all entries so far
        setup.before.append(write)


@dataclass(frozen=True)
class Function(Place):
    """A function of one's own, `set(env.unwrapped, value)`, called once in each episode.

    Scores of a function are kept in an evaluation store only with an `agent_id`, which its owner
    changes with the function.

    Attributes:
        set: The function. It must be importable where worker processes take part.
        after_reset: Whether it is called after `reset` or before it.
    """

    set: Callable[[Any, Any], None] | None = None
    after_reset: bool = True

    @property
    def own_code(self) -> bool:
        """It is the user's own code."""
        return True

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:  # noqa: ARG002
        """Check that there is a function."""
        if not callable(self.set):
            raise UserTypeError(
                f"Expected a function set(env, value) for {name!r}, got {self.set!r}. Write "
                "Function(1.0, 2.0, set=set_mass)."
            )

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Call the function before or after `reset`."""

        def call(env: Any) -> None:
            assert self.set is not None
            try:
                self.set(env, value)
            except Exception as error:  # whatever a user's function may raise
                raise UserError(
                    f"Expected the function of {name!r} to set {value!r}, got "
                    f"{type(error).__name__}: {error}."
                ) from error

        (setup.after if self.after_reset else setup.before).append(call)


def found_place(name: str, given: Any, maker: Maker) -> Place:
    """Give the place of a parameter: the one that was named, or the one that its name finds.

    Args:
        name: The parameter's name.
        given: A `Place`, or (low, high).
        maker: Makes the environments.

    Raises:
        UserError: If it is neither.
    """
    if isinstance(given, Place):
        return given
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise UserTypeError(
            f"Expected (low, high) or a place such as Attribute(low, high) for parameter {name!r}, "
            f"got {given!r}."
        )
    return Keyword(*given) if name in maker.keywords else Attribute(*given)


def plain(value: Any) -> Any:
    """Turn NumPy's numbers, tuples and mappings into what JSON holds."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [*map(plain, value)]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value
