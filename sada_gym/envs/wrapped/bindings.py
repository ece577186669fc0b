"""What a parameter sets: a keyword, an attribute, an option of reset, a configuration's entry."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, KeysView, Mapping, Sequence, ValuesView
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, get_args

import gymnasium as gym
import numpy as np
from typing_extensions import Self

from sada_gym.densities import Density
from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.factory import EnvFactory, code_name
from sada_gym.envs.wrapped.paths import (
    names_several,
    no_such_path,
    read,
    scale,
    scaled,
    write,
)
from sada_gym.envs.wrapped.profiles import MOST_KNOTS, Curve, Profile
from sada_gym.errors import (
    InvalidWorld,
    UserError,
    UserTypeError,
    check_integer,
    check_known,
    explained,
    plain,
)
from sada_gym.foundations.arrays import as_array
from sada_gym.foundations.serve_environment import MISSING, Opaque
from sada_gym.parameters import Parameter

_ALL = ", or all by [:] at its end"
_LARGEST_WHOLE = 2**51
"""Half below and half above larger whole numbers are no floats."""

_AROUND = ("around 0°", "around 90°", "around 180°", "around 270°")
_SEAM = 0.002
"""How much a range may differ from a full turn, as 6.28 does."""

_NAMED_VALUES = 12
"""Whole numbers are named one by one on axes where there are at most so many."""


@dataclass(frozen=True)
class ParameterBinding(ABC):
    """What a parameter sets in an episode.

    A subclass overrides the methods for the moments at which it sets something.

    Attributes:
        low: The value at mu = -1.
        high: The value at mu = +1.
        unit: The unit in tables and on axes.
        choices: Values to choose from, equal parts of [-1, 1], instead of `low` and `high`. Each
            episode gets a copy of its value.
        integer: Whether the values are the whole numbers from `low` to `high`, equal parts each.
        log: Whether mu is even in the logarithm of the values, which all have one sign.
        angle: Whether the value is an angle that goes all around, from `low` to `high`: 360
            degrees, or 2 pi, which is told in degrees. Its ends are one place.
        directions: What lies at 0, 90, 180 and 270 degrees of an angle, for sentences.
        nominal: The value in ordinary use, or its density as `sada_gym.densities.Density` takes
            it; None takes the environment's own value.
        knots: Makes the value a curve over the episode through so many parameters, which are named
            `wind[0]`, `wind[1]` and so on. None keeps it the same.
        curve: How it goes between the knots: `"linear"`, `"cubic"` or `"steps"`.
        over: The steps of the environment over which the knots lie; None takes the limit of an
            episode, or all steps of a force that acts for some steps.
    """

    varies: ClassVar[bool] = False
    """Whether the value may change during an episode."""
    low: float | None = None
    high: float | None = None
    unit: str = field(default="", kw_only=True)
    choices: tuple[Any, ...] = field(default=(), kw_only=True)
    integer: bool = field(default=False, kw_only=True)
    log: bool = field(default=False, kw_only=True)
    angle: bool = field(default=False, kw_only=True)
    directions: tuple[str, ...] = field(default=(), kw_only=True)
    nominal: float | str | bool | Mapping[str, Any] | None = field(default=None, kw_only=True)
    knots: int | None = field(default=None, kw_only=True)
    curve: Curve = field(default="linear", kw_only=True)
    over: int | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Take choices in any collection that has an order."""
        if self.choices is not None and not isinstance(self.choices, str | tuple):
            object.__setattr__(self, "choices", _in_order(self.choices))

    def within(self, name: str, limit: int | None) -> Self:
        """Return the binding in episodes of at most so many steps; None where nobody knows it.

        Raises:
            UserError: If it has knots that are bad, or no place on the way of an episode.
        """
        if self.knots is None:
            if self.over is not None or self.curve != "linear":
                raise UserError(
                    f"Expected knots with curve= or over= of {name!r}, got none. Write knots=5."
                )
            return self
        check_integer(f"knots of {name!r}", self.knots, 2, MOST_KNOTS)
        check_known(f"curve of {name!r}", [self.curve], get_args(Curve))
        if not self.varies:
            raise UserError(
                f"Expected knots for what may change during an episode, got {name!r}, a "
                f"{type(self).__name__}, which has one value in it. Leave knots out."
            )
        if self.angle or self.directions or (self.choices and self.curve != "steps"):
            raise UserError(
                f"Expected numbers on a line as {name!r} with knots, or choices with "
                "curve='steps', because nothing lies between others. Leave knots out."
            )
        if self.over is None and limit is None:
            raise UserError(
                f"Expected over= of {name!r}, the steps that its {self.knots} knots lie over, "
                "because no limit of steps is known. Write over=500."
            )
        over = limit if self.over is None else self.over
        check_integer(f"the steps of {name!r}, over which its knots lie,", over, self.knots)
        return replace(self, over=over)

    @property
    def count(self) -> int:
        """How many parameters it has."""
        return self.knots or 1

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return its parameters: that of its name, or one for each knot."""
        one = self.parameter(name)
        return tuple(replace(one, name=own) for own in self._own_names(name))

    def _own_names(self, name: str) -> list[str]:
        return [name] if self.knots is None else [f"{name}[{i}]" for i in range(self.knots)]

    def named(self, name: str, values: Any) -> dict[str, Any]:
        """Return what its parameters set, by their names, from what it sets."""
        if self.knots is None:
            return {name: values}
        return dict(zip(self._own_names(name), values.values, strict=True))

    def world_value(self, numbers: Sequence[float]) -> Any:
        """Return what an episode gets for the physical values of its parameters."""
        if self.knots is None:
            return self.value(numbers[0])
        assert self.over is not None
        values = tuple(map(self.value, numbers))
        return Profile(values, self.over, self.curve, self.integer)

    def places(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> list[float | None]:
        """Return the physical values of its parameters in ordinary use, see `nominal_place`."""
        return [self.nominal_place(name, factory, env)] * self.count

    def densities(self, name: str) -> dict[str, Density]:
        """Return the densities of its parameters, by their names."""
        density = self.density
        return {} if density is None else dict.fromkeys(self._own_names(name), density)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name; raise `UserError` if its range is empty or missing."""
        for flag in ("integer", "log", "factor", "angle"):
            if not isinstance(given := getattr(self, flag, False), bool):
                raise UserTypeError(
                    f"Expected {flag} of {name!r} to be True or False, got {given!r}."
                )
        if self.choices:
            if isinstance(self.choices, str) or len(self.choices) < 2:
                raise UserError(
                    f"Expected at least two choices of {name!r}, got {self.choices!r}. Write "
                    "choices=('dry', 'wet')."
                )
            if self.low is not None or self.high is not None or self.integer or self.log:
                raise UserError(
                    f"Expected either choices or low and high for {name!r}, got both. Leave low, "
                    "high, integer and log out."
                )
            names = tuple(plain(str(choice)) for choice in self.choices)
            if doubles := [name for name in names if names.count(name) > 1]:
                raise UserError(
                    f"Expected choices of {name!r} that read differently, got {doubles[0]!r} "
                    f"{len(doubles)} times. Leave the others out."
                )
            return Parameter(name, 0.0, float(len(names)), self.unit, choices=names)
        low, high = self._range(name)
        if self.angle or self.directions:
            return self._full_turn(name, low, high)
        if not self.integer:
            return Parameter(name, low, high, self.unit, log=self.log)
        if low != round(low) or high != round(high):
            raise UserError(
                f"Expected whole numbers as low and high of {name!r}, which is an integer, got "
                f"{self.low} and {self.high}."
            )
        Parameter(name, low, high, log=self.log)  # raises for an empty range
        if max(abs(low), abs(high)) > _LARGEST_WHOLE:
            raise UserError(
                f"Expected whole numbers of {name!r} within -2**51 and 2**51, got {self.low} and "
                f"{self.high}. Leave integer out, or narrow the range."
            )
        count = int(high - low) + 1
        named = count <= _NAMED_VALUES and not self.log  # parts with names are equal
        names = tuple(str(int(low) + i) for i in range(count)) if named else ()
        return Parameter(
            name, low - 0.5, high + 0.5, self.unit, choices=names, log=self.log, whole=True
        )

    def _full_turn(self, name: str, low: float, high: float) -> Parameter:
        turn = 360.0 / self._degrees
        if abs(high - low - turn) > _SEAM * turn or self.integer or self.log:
            raise UserError(
                f"Expected low and high of {name!r}, an angle, to lie 360 degrees or 2 pi apart, "
                f"and neither integer nor log, got low={low:g} and high={high:g}. Leave angle and "
                "directions out where it does not go all around."
            )
        if self.unit != "deg" and self.density is not None:
            raise UserError(
                f"Expected a density of the angle {name!r} in degrees, got one in radians. Give "
                "low, high and nominal in degrees."
            )
        first = low * self._degrees
        return Parameter(name, first, first + 360.0, "deg", directions=self.directions or _AROUND)

    @property
    def _degrees(self) -> float:
        """How many degrees the unit of an angle has: 1, or those of a radian."""
        low, high = self._range("")
        return 1.0 if not (self.angle or self.directions) or high - low > 7.0 else 180.0 / np.pi

    def looks_like_angle(self) -> bool:
        """Say whether the range looks like that of an angle, and nobody says so."""
        plain_number = not (self.choices or self.angle or self.directions or self.integer)
        if not plain_number or self.log or self.low is None:  # an event may have no value
            return False
        low, high = self._range("")
        turn = {"deg": 360.0, "rad": 2.0 * np.pi, "": 2.0 * np.pi}.get(self.unit, np.nan)
        return bool(abs(high - low - turn) <= _SEAM * turn)

    def value(self, physical: float) -> Any:
        """Return what the environment gets for a physical value of the parameter."""
        if self.choices:
            return deepcopy(self.choices[min(int(physical), len(self.choices) - 1)])
        if self.integer:
            low, high = self._range("")
            return int(min(max(np.floor(physical + 0.5), low), high))
        return physical / self._degrees

    def _range(self, name: str) -> tuple[float, float]:
        if not (is_number(self.low) and is_number(self.high)):
            raise UserTypeError(
                f"Expected numbers as low and high of {name!r}, got {self.low!r} and "
                f"{self.high!r}. Write low=1.0, high=2.0."
            )
        ends: tuple[Any, Any] = (self.low, self.high)
        if not all(abs(end) <= sys.float_info.max for end in ends):
            raise UserError(
                f"Expected finite low < high for parameter {name!r}, got low={self.low} and "
                f"high={self.high}. Give a non-empty range."
            )
        return float(ends[0]), float(ends[1])

    def nominal_place(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> float | None:
        """Return the physical value of the parameter in ordinary use.

        None stands for an unknown value, or one of the environment's that lies outside the range.

        Raises:
            UserError: If the given `nominal` lies outside the range, or is none of the choices.
        """
        if (density := self.density) is not None:
            centre = density.centre
            return self._place(round(centre) if self.integer and is_number(centre) else centre)
        present = self.present(name, factory, env) if self.nominal is None else self.nominal
        place = self._place(present)
        if place is None and self.nominal is not None:
            lies = f"one of {self.choices}" if self.choices else f"from {self.low} to {self.high}"
            raise UserError(
                f"Expected nominal of {name!r} to be {lies}, got {self.nominal!r}. Widen the "
                "range, or leave nominal out."
            )
        return place

    @property
    def density(self) -> Density | None:
        """The density of `nominal`; None where that is none. It raises `UserError` if it is bad."""
        return Density(self.nominal) if isinstance(self.nominal, Mapping) else None

    def _place(self, value: Any) -> float | None:
        if self.choices:
            for i, choice in enumerate(self.choices):  # among which True is no 1
                same_kind = isinstance(value, bool) == isinstance(choice, bool)
                if same_kind and as_json(value) == as_json(choice):
                    return i + 0.5
            return None
        low, high = self._range("")
        if not is_number(value) or isinstance(value, bool):
            return None
        number = float(value)
        if (self.angle or self.directions) and np.isfinite(number):
            number = low + (number - low) % (high - low)
        if not low <= number <= high or (self.integer and not number.is_integer()):
            return None
        return number * self._degrees

    def present(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> Any:  # noqa: ARG002
        """Return the value that `env`, made by `factory`, has; None where nobody knows it."""
        return None

    @property
    def settings(self) -> dict[str, Any]:
        """The binding as data for JSON: its kind, and the fields that differ from their default."""
        settings: dict[str, Any] = {"kind": type(self).__name__}
        for spec in fields(self):
            value = getattr(self, spec.name)
            if value != spec.default and spec.name != "nominal":  # no score depends on it
                settings[spec.name] = code_name(value) if callable(value) else as_json(value)
        return settings

    @property
    def own_function(self) -> Callable[..., Any] | None:
        """The function of the user's that it calls, if any; no fingerprint covers its code."""
        return None

    @abstractmethod
    def targets(self, name: str) -> tuple[Any, ...]:
        """Return all that the parameter of this name sets; () where that is unknown."""

    def check(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> None:  # noqa: B027
        """Check on one environment of `factory` that it has what the parameter sets."""

    def set_value(self, name: str, value: Any, env: Any, *, after_reset: bool) -> None:  # noqa: B027
        """Set the value in `env`, the unwrapped one; called before and right after its reset."""

    def set_during(self, name: str, value: Any, env: Any, first: dict[str, Any]) -> None:  # noqa: ARG002
        """Set a value that changes, after the reset and before each step.

        `first` keeps what an episode of this environment began with.
        """
        self.set_value(name, value, env, after_reset=True)


@dataclass(frozen=True)
class _Named(ParameterBinding):
    """It sets what has a name, the parameter's by default."""

    name: str | None = None

    def targets(self, name: str) -> tuple[str, ...]:
        return (self.name or name,)


class Keyword(_Named):
    """A keyword of the environment's constructor.

    Attributes:
        name: The keyword; None takes the parameter's name.
    """

    def check(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> None:  # noqa: ARG002
        """Check that the constructor takes the keyword, and that nothing else sets it."""
        keyword = self.name or name
        if not factory.takes_any_keyword:
            check_known(f"keyword of {factory.name}", [keyword], factory.keywords)
        if keyword in factory.env_kwargs:
            raise UserError(
                f"Expected {keyword!r} either among the parameters or in env_kwargs, got it in "
                "both. Leave it out of env_kwargs."
            )

    def present(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> Any:
        """Return the keyword's default, or an attribute of its name where it has none."""
        keyword = self.name or name
        default = factory.defaults.get(keyword)
        return _plain(getattr(env.unwrapped, keyword, None) if default is None else default)


class ResetOption(_Named):
    """An entry of `reset(options={...})`.

    Attributes:
        name: The entry; None takes the parameter's name.
    """


class Config(_Named):
    """An entry of `env.unwrapped.config`, a dictionary such as highway-env's environments have.

    It is set before `reset`.

    Attributes:
        name: The entry: a key, or a path with dots between the levels of nested dictionaries
            (`observation.vehicles_count`) and indices of lists (`speeds[0]`). None takes the
            parameter's name.
    """

    def check(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> None:
        """Check that the entry exists."""
        config = getattr(env.unwrapped, "config", None)
        if not isinstance(config, dict):
            raise UserError(
                f"Expected {factory.name} to have a dictionary `config` for {name!r}, got "
                f"{config!r}. Name an attribute or a keyword instead."
            )
        if read(env.unwrapped, self._path(name, config)) is MISSING:
            entry = self.name or name
            check_known(f"entry of the configuration of {factory.name}", [entry], [*config])

    def present(self, name: str, factory: EnvFactory, env: Any) -> Any:  # noqa: ARG002
        """Return the entry's value."""
        return _plain(read(env.unwrapped, self._path(name, env.unwrapped.config)))

    def set_value(self, name: str, value: Any, env: Any, *, after_reset: bool) -> None:
        """Write the value into a copy of the configuration before the reset."""
        if after_reset:
            return
        env.config = deepcopy(env.config)
        write(env, self._path(name, env.config), value, must_exist=True)

    def _path(self, name: str, config: Mapping[Any, Any]) -> str:
        entry = self.name or name
        return f'config["{entry}"]' if entry in config else f"config.{entry}"


@dataclass(frozen=True)
class Attribute(ParameterBinding):
    """An attribute of `env.unwrapped`, set before `reset`, and again if `reset` changed it.

    It is set before `reset` for environments that build their world in `reset`. An attribute that
    exists only after `reset`, such as the lander of LunarLander, is set after it. The episode's
    first observation may then come from the old value.

    Attributes:
        paths: One or several paths, such as `length`, `model.opt.timestep`, `model.body_mass[1]`,
            `model.geom_friction[:,0]` or `params["mass"]`. Each gets the value, and so does each
            entry of a slice. None takes the parameter's name.
        factor: Whether the attribute is multiplied by the value instead: the number, or each number
            of an array, that the environment or its reset has set.
    """

    varies: ClassVar[bool] = True
    paths: str | tuple[str, ...] | None = None
    factor: bool = False

    def targets(self, name: str) -> tuple[str, ...]:
        """Return the paths."""
        if self.paths is None:
            return (name,)
        return (self.paths,) if isinstance(self.paths, str) else tuple(self.paths)

    def check(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> None:
        """Check that the attributes exist and hold single values."""
        if self.factor and not all(map(is_number, self.choices)):
            raise UserTypeError(
                f"Expected numbers as choices of {name!r}, which is a factor, got "
                f"{self.choices!r}. Leave factor out."
            )
        for path in self.targets(name):
            value = read(env.unwrapped, path)
            if value is MISSING:
                raise no_such_path(name, path, factory, env)
            if callable(value) or isinstance(value, Opaque):
                kind = "a function" if callable(value) else value
                raise UserError(
                    f"Expected a value at {path!r} of {factory.name} for {name!r}, got {kind}. "
                    "Name an attribute that holds a number."
                )
            has_many = (isinstance(value, np.ndarray) and value.ndim) or isinstance(value, list)
            if isinstance(value, dict) or (has_many and not (self.factor or names_several(path))):
                raise UserError(
                    f"Expected a single value at {path!r} of {factory.name}, got "
                    f"{type(value).__name__} of length {len(value)}. Name one entry, such as "
                    f"{_entry_of(path, value)!r}{'' if isinstance(value, dict) else _ALL}."
                )
            if self.factor or has_many:
                self._check_numbers(name, path, value, factory)

    def _check_numbers(self, name: str, path: str, value: Any, factory: EnvFactory) -> None:
        numbers = as_array(value, f"what is at {path!r}")
        if not numbers.size:
            raise UserError(
                f"Expected an entry at {path!r} of {factory.name} for {name!r}, got none. Fix the "
                "slice."
            )
        if numbers.dtype.kind not in "iuf":
            raise UserError(
                f"Expected numbers at {path!r} of {factory.name} for {name!r}, got {value!r}. Name "
                "an attribute that holds a number, or an array of them."
            )
        if isinstance(value, np.ndarray) and numbers.dtype.kind in "iu" and not self.integer:
            raise UserError(
                f"Expected numbers with a fraction at {path!r} of {factory.name} for {name!r}, got "
                f"{numbers.dtype}, which would round them. Write integer=True."
            )

    def present(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> Any:  # noqa: ARG002
        """Return the attribute's value, or the factor 1; None where several values differ."""
        if self.factor:
            return 1
        values: list[Any] = []
        for path in self.targets(name):
            value = read(env.unwrapped, path)
            values += np.ravel(value).tolist() if names_several(path) else [_plain(value)]
        return values[0] if all(value == values[0] for value in values) else None

    def set_value(self, name: str, value: Any, env: Any, *, after_reset: bool) -> None:
        """Set the attributes that exist, and after the reset those that it made or changed."""
        for path in self.targets(name):
            if self.factor and self.knots is not None:
                continue  # `set_during` multiplies what the reset put there
            if self.factor:
                scale(env, path, value, after_reset=after_reset)
            else:
                write(env, path, value, must_exist=after_reset)

    def set_during(self, name: str, value: Any, env: Any, first: dict[str, Any]) -> None:
        """Set the attributes, or multiply what the reset put there."""
        if not self.factor:
            return super().set_during(name, value, env, first)
        for path in self.targets(name):
            if path not in first:
                first[path] = deepcopy(read(env, path))
            write(env, path, scaled(first[path], value), must_exist=True)
        return None


@dataclass(frozen=True)
class Function(ParameterBinding):
    """A function of your own, `set(env.unwrapped, value)`, called once in each episode.

    With `knots` it is called after the reset and before each step.

    An evaluation store keeps the scores only if you give an `agent_id`; change that whenever you
    change the function.

    Attributes:
        set: The function. With worker processes it must be importable.
        after_reset: Whether it is called after `reset`, or before.
    """

    varies: ClassVar[bool] = True
    set: Callable[[Any, Any], None] | None = None
    after_reset: bool = True

    @property
    def own_function(self) -> Callable[..., Any] | None:
        """The function."""
        return self.set

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return (): what the function sets is unknown."""
        return ()

    def check(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> None:  # noqa: ARG002
        """Check that there is a function."""
        if not callable(self.set):
            raise UserTypeError(
                f"Expected a function set(env, value) for {name!r}, got {self.set!r}. Write "
                "Function(1.0, 2.0, set=set_mass)."
            )
        if self.knots is not None and not self.after_reset:
            raise UserError(
                f"Expected after_reset=True of {name!r} with knots, which sets values during the "
                "episode, got False. Leave it out."
            )

    def set_value(self, name: str, value: Any, env: Any, *, after_reset: bool) -> None:
        """Call the function, before or after the reset."""
        assert self.set is not None
        if after_reset == self.after_reset:
            expected = f"Expected the function of {name!r} to set {value!r}"
            with explained(expected, kind=InvalidWorld):
                self.set(env, value)


def as_binding(name: str, given: Any, factory: EnvFactory) -> ParameterBinding:
    """Return a given binding, or that of (low, high) to the keyword or attribute of this name."""
    if isinstance(given, ParameterBinding):
        return given
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise UserTypeError(
            f"Expected (low, high) or a binding such as Attribute(low, high) for parameter "
            f"{name!r}, got {given!r}."
        )
    return Keyword(*given) if name in factory.keywords else Attribute(*given)


def _entry_of(path: str, value: Any) -> str:
    return f'{path}["{next(iter(value), "key")}"]' if isinstance(value, dict) else f"{path}[0]"


def _in_order(given: Any) -> tuple[Any, ...]:
    """Return choices as a tuple; a UserError for what has no order, or gives it away once only."""
    ordered = isinstance(given, Sequence | KeysView | ValuesView) and not isinstance(given, bytes)
    if not ordered and not getattr(given, "ndim", 0):
        raise UserTypeError(
            f"Expected choices in an order, such as ('dry', 'wet'), got {type(given).__name__}. "
            "Write a tuple."
        )
    return tuple(map(_plain, given))


def _plain(value: Any) -> Any:
    is_single = isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim)
    return value.item() if is_single else value


def check_distinct(bindings: Mapping[str, ParameterBinding]) -> None:
    """Check that no two parameters set the same, so that one would be without effect.

    Noise on other entries is something else.
    """
    names: dict[Any, str] = {}
    for name, binding in bindings.items():
        for target in dict.fromkeys(binding.targets(name)):
            key = (type(binding), target)
            if key in names:
                raise UserError(
                    f"Expected one {type(binding).__name__}, got {names[key]!r} and {name!r} for "
                    "the same target. Leave one out."
                )
            names[key] = name


def as_json(value: Any) -> Any:
    """Turn NumPy's numbers, tuples and mappings into what JSON holds."""
    if isinstance(value, Mapping):
        return {as_json(str(key)): as_json(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [*map(as_json, value)]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, str):  # of a file's name, say, that is not UTF-8
        return value.encode(errors="backslashreplace").decode()
    return value
