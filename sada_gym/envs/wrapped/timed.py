"""What holds for some steps of an episode: when and for how long may be parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
from typing_extensions import Self

from sada_gym.densities import Density
from sada_gym.envs.wrapped.bindings import Keyword, ParameterBinding
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.errors import UserError, check_integer
from sada_gym.parameters import Parameter

Steps = int | tuple[int, int]
"""A number of steps, or the range of a parameter that says it."""


class Occurrence(NamedTuple):
    """What an episode gets of it: a value, True where there is none, and its steps."""

    value: Any
    at: int
    lasts: int


@dataclass(frozen=True)
class Timed(ParameterBinding):
    """It holds for some steps.

    Attributes:
        at: The environment's step at which it begins, from 0. A range (first, last) makes that a
            parameter, `NAME_at`.
        lasts: For how many steps it holds; a range makes that a parameter, `NAME_lasts`. With 0
            nothing happens.
    """

    passes: ClassVar[bool] = False
    """Whether it must have steps."""
    at: Steps | None = field(default=None, kw_only=True)
    lasts: Steps | None = field(default=None, kw_only=True)

    @property
    def valued(self) -> bool:
        """Whether it has a value, besides its steps."""
        return self.low is not None or self.high is not None or bool(self.choices)

    @property
    def _times(self) -> dict[str, Keyword]:
        """What says which steps: a whole number from low to high each, by name."""
        ranges = {"at": self.at, "lasts": self.lasts}
        return {
            key: Keyword(*given, integer=True, unit="steps")
            for key, given in ranges.items()
            if isinstance(given, tuple | list)
        }

    @property
    def usual_lasts(self) -> int | None:
        """For how many steps it holds where `lasts` does not say it; None means all."""
        return None

    @property
    def holds_always(self) -> bool:
        """Whether it holds in all steps."""
        return self.at is self.lasts is self.usual_lasts is None

    def within(self, name: str, limit: int | None) -> Self:
        """Check the steps, and let a curve go over those in which it holds."""
        given, lasts = self, self.usual_lasts
        if self.at is not None and self.lasts is None and lasts is not None:
            given = replace(self, lasts=lasts)
        if self.passes or given.at is not None or given.lasts is not None:
            given._check_times(name, limit)
            lasts = given.lasts[1] if isinstance(given.lasts, tuple | list) else given.lasts
        return super(Timed, given).within(name, limit if lasts is None else lasts)

    def _check_times(self, name: str, limit: int | None) -> None:
        for key, given in {"at": self.at, "lasts": self.lasts}.items():
            ends = given if isinstance(given, tuple | list) else (given,)
            if given is None or len(ends) > 2 or (len(ends) == 2 and not ends[0] < ends[1]):
                raise UserError(
                    f"Expected {key} of {name!r} to be a number of steps, such as 5, or a range "
                    f"such as (20, 80), got {given!r}."
                )
            for end in ends:
                check_integer(f"{key} of {name!r}", end, 0)
        first = self.at[0] if isinstance(self.at, tuple | list) else self.at
        if limit is not None and first is not None and first >= limit:
            raise UserError(
                f"Expected at of {name!r} within an episode of {limit} steps, got {self.at!r}. It "
                "would never happen."
            )

    @property
    def count(self) -> int:
        """How many parameters it has: those of its value, and of its steps."""
        return self.valued * super().count + len(self._times)

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return the parameters of its value and of its steps."""
        own = super().parameters(name) if self.valued else ()
        times = self._times.items()
        return (*own, *(when.parameter(f"{name}_{key}") for key, when in times))

    def named(self, name: str, values: Any) -> dict[str, Any]:
        """Return the value and the steps by the names of their parameters."""
        if not isinstance(values, Occurrence):
            return super().named(name, values) if self.valued else {}
        own = super().named(name, values.value) if self.valued else {}
        return own | {f"{name}_{key}": getattr(values, key) for key in self._times}

    def world_value(self, numbers: Sequence[float]) -> Any:
        """Return the `Occurrence` in an episode."""
        own = self.valued * super().count
        value = super().world_value(numbers[:own]) if self.valued else True
        return self._in_time(value, numbers[own:])

    def _in_time(self, value: Any, numbers: Sequence[float]) -> Any:
        """Return a value in its steps, where it has some."""
        times: dict[str, Any] = {"at": self.at, "lasts": self.lasts}
        for (key, when), number in zip(self._times.items(), numbers, strict=True):
            times[key] = when.value(number)
        return value if self.at is None else Occurrence(value, **times)

    @property
    def _middle_times(self) -> dict[str, float]:
        """The middles of the ranges of its steps: when it is does not matter if nothing happens."""
        return {key: float(sum(when._range("")) // 2) for key, when in self._times.items()}

    def places(self, name: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> list[float | None]:
        """Return where its parameters lie in ordinary use, in which nothing happens."""
        own = super().places(name, factory, env)[: super().count] if self.valued else []
        middle = self._middle_times
        if "lasts" in middle and self._times["lasts"].low == 0:
            middle["lasts"] = 0.0
            own = [sum(self._range("")) / 2 if one is None else one for one in own]
        elif not self.valued:
            return [None] * self.count
        return [*own, *middle.values()]

    def densities(self, name: str) -> dict[str, Density]:
        """Return the density of its value."""
        return super().densities(name) if self.valued else {}
