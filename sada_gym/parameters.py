"""Semantic parameters: names, units, and the map between [-1, 1]^d and physical values."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError, UserTypeError, check_plain
from sada_gym.foundations.arrays import Bools, Floats, Floats32, as_array, real_numbers
from sada_gym.foundations.figures import number

_LONGEST_NAME = 100
_MANTISSAS = ((1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,))

Mu = npt.NDArray[np.float32]
"""A batch of normalised semantic parameters, (n, d) float32 in [-1, 1]."""

Permits = Callable[[Mu], Bools]
"""Says which worlds of mu, (n, d), can exist at all, (n,)."""


def all_can_exist(mu: Mu) -> Bools:
    """Permit every world."""
    return np.ones(len(mu), np.bool_)


@dataclass(frozen=True)
class Parameter:
    """One semantic parameter of a world.

    `low` and `high` are its physical values at mu = -1 and +1.

    Attributes:
        name: The name with its unit as suffix, such as `camera_azimuth_deg`.
        unit: The unit in tables and on axes, such as `deg`; empty if there is none.
        choices: If the parameter is a choice: the names of equal parts of the range.
        directions: If the parameter is an angle over a full circle: names of 0, 90, 180 and 270
            degrees for sentences, such as `("in front", "on the left", "behind", "on the right")`.
        whole: Whether values are whole numbers. The range then begins 0.5 below the first and ends
            0.5 above the last.
        log: Whether the scale is logarithmic; `low` and `high` then have the same sign.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    choices: tuple[str, ...] = ()
    directions: tuple[str, ...] = ()
    log: bool = False
    whole: bool = False

    def __post_init__(self) -> None:
        """Check the name, the range and the directions."""
        if not isinstance(self.name, str) or not self.name:
            raise UserTypeError(f"Expected a parameter's name to be a text, got {self.name!r}.")
        if len(self.name) > _LONGEST_NAME:
            raise UserError(
                f"Expected a parameter's name in one line of at most {_LONGEST_NAME} characters, "
                f"got {self.name[: 2 * _LONGEST_NAME]!r}."
            )
        check_plain("a parameter's name", self.name)
        for text in (self.unit, *self.choices, *self.directions):
            check_plain(f"a unit, choice or direction of {self.name!r}", text)
        ends = (self.low, self.high)
        numbers = all(isinstance(end, int | float | np.number) for end in ends)
        finite = numbers and all(abs(end) <= sys.float_info.max for end in ends)
        if not finite or not 0.0 < float(self.high) - float(self.low) < np.inf:
            raise UserError(
                f"Expected finite low < high for parameter {self.name!r}, "
                f"got low={self.low} and high={self.high}. Give a non-empty range."
            )
        if self.log and (self.choices or self.directions or float(self.low) * self.high <= 0.0):
            raise UserError(
                f"Expected low and high of one sign, and not 0, for parameter {self.name!r} with "
                f"log=True, and neither choices nor directions, got low={self.low} and "
                f"high={self.high}. Raise low above 0, or leave log out."
            )
        around = abs(float(self.high) - float(self.low) - 360.0) < 1e-9
        if self.directions and (len(self.directions) != 4 or not around or self.choices):
            raise UserError(
                f"Expected four directions of an angle over 360 degrees for {self.name!r}, got "
                f"{self.directions!r} from {self.low:g} to {self.high:g}. Leave directions out."
            )

    @property
    def label(self) -> str:
        """The name as people say it: without its unit and underscores."""
        suffix = f"_{self.unit.replace('/', '_')}" if self.unit else ""
        has_unit = bool(suffix) and self.name.lower().endswith(suffix.lower())
        return self.name[: -len(suffix) if has_unit else None].replace("_", " ")

    @property
    def count(self) -> int:
        """How many choices or whole numbers there are; 0 where any number of the range counts."""
        whole = round(self.high - self.low) if self.whole else 0
        return len(self.choices) or whole

    def shares(self, values: npt.ArrayLike) -> Floats:
        """Return where in the range physical values lie: 0 at low, 1 at high, the same shape.

        Where a logarithm has no value, on the far side of 0, the share is infinite.
        """
        physical, low, high = np.asarray(values, np.float64), float(self.low), float(self.high)
        if not self.log:
            linear: Floats = (physical - low) / (high - low)
            return linear
        sign = np.sign(low)
        with np.errstate(divide="ignore"):
            place = np.log(np.maximum(sign * physical, 0.0))
        ends = np.log([sign * low, sign * high])
        even: Floats = (place - ends[0]) / (ends[1] - ends[0])
        return even

    def values(self, shares: npt.ArrayLike) -> Floats:
        """Return the physical values at shares of the range: the inverse of `shares`."""
        share, low, high = np.asarray(shares, np.float64), float(self.low), float(self.high)
        if not self.log:
            linear: Floats = low + share * (high - low)
            return linear
        sign = np.sign(low)
        first, last = np.log([sign * low, sign * high])
        inside = np.clip(sign * np.exp(first + share * (last - first)), low, high)
        values: Floats = np.where(share == 0.0, low, np.where(share == 1.0, high, inside))
        return values

    def round_values(self, most: int) -> Floats:
        """Return at most so many round values inside the range, low to high; empty if none fit.

        Along a logarithmic range they are of the kind 1, 2, 5, 10, 20; where that has less than
        two of them, and along other ranges, they are evenly spaced.
        """
        low, high = float(self.low), float(self.high)
        if self.log and max(low / high, high / low) >= 10.0:
            first, last = sorted((abs(low), abs(high)))
            tens = range(math.floor(math.log10(first)), math.floor(math.log10(last)) + 1)
            for mantissas in _MANTISSAS:
                found = np.array([float(f"{m}e{ten}") for ten in tens for m in mantissas])
                found = found[(found > first) & (found < last)]
                if len(found) <= most:
                    break
            found = found[:: max(1, -(-len(found) // most))]
            return found if low > 0.0 else -found[::-1]
        power = 10.0 ** math.floor(math.log10((high - low) / most))
        steps = (step * power for step in (1, 2, 5, 10))
        step = next(step for step in steps if (high - low) / step <= most)
        first, last = math.floor(low / step + 1e-9) + 1, math.ceil(high / step - 1e-9)
        return np.array([step * i for i in range(first, last)])

    def text(self, value: float) -> str:
        """Write a physical value as people say it, such as `camera pitch 35°` or `light low`."""
        if count := len(self.choices):
            place = (value - self.low) / (self.high - self.low) * count
            return f"{self.label} {self.choices[min(int(place), count - 1)]}"
        if self.whole:
            value = min(max(math.floor(value + 0.5), self.low + 0.5), self.high - 0.5)
        elif not self.log:
            digits = 3 - math.floor(math.log10(self.high - self.low))
            if abs(value) < 100 * 10.0**-digits:  # 8.44e-05 m of a range of 0.3 m is 0.0001 m
                value = round(value, digits) + 0.0
        return f"{self.label} {self.with_unit(number(value))}"

    def with_unit(self, written: str) -> str:
        """Add the unit to a number, as in `35°`, `3 m` or `2 per m²`."""
        if self.unit.startswith("1/"):
            return f"{written} per {self.unit[2:]}"
        return f"{written}°" if self.unit == "deg" else f"{written} {self.unit}".rstrip()


class ParameterSpace:
    """The parameters of a world, in the order of mu's columns: the box that adversaries search."""

    def __init__(self, *parameters: Parameter) -> None:
        if not parameters:
            raise UserError("Expected at least one Parameter, got none. Name what mu controls.")
        for parameter in parameters:
            if not isinstance(parameter, Parameter):
                raise UserTypeError(
                    f"Expected Parameter objects, one after another, got {parameter!r}. Write "
                    "ParameterSpace(Parameter(...), Parameter(...))."
                )
        names = [parameter.name for parameter in parameters]
        if len(set(names)) != len(names):
            raise UserError(f"Expected distinct parameter names, got {names}. Rename the doubles.")
        self.parameters = parameters
        self._low = np.array([p.low for p in parameters])
        self._high = np.array([p.high for p in parameters])
        self._logs = [(i, p) for i, p in enumerate(parameters) if p.log]

    def __len__(self) -> int:
        """Return the dimension d."""
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        """Yield the parameters."""
        return iter(self.parameters)

    def __repr__(self) -> str:
        """List the parameters."""
        return f"ParameterSpace({', '.join(map(repr, self.parameters))})"

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names, in the order of mu's columns."""
        return tuple(parameter.name for parameter in self.parameters)

    def lines(self, values: Iterable[float], count: int) -> list[str]:
        """Format physical values, one for each parameter, as lines of `count` values each."""
        written = [one.text(value) for one, value in zip(self.parameters, values, strict=True)]
        return [", ".join(written[k : k + count]) for k in range(0, len(written), count)]

    def validate(self, mu: npt.ArrayLike) -> Mu:
        """Return mu, an (n, d) batch in [-1, 1], as float32; raise `UserError` if it is not one."""
        return validate_mu(mu, len(self))

    def physical(self, mu: npt.ArrayLike) -> Floats:
        """Map mu, (n, d) or (d,) in [-1, 1], to physical values of the same shape, float64."""
        share = (as_array(mu, "mu").astype(np.float32).astype(np.float64) + 1.0) / 2.0
        physical: Floats = self._low + share * (self._high - self._low)
        for i, parameter in self._logs:
            physical[..., i] = parameter.values(share[..., i])
        return physical

    def normalised(self, physical: npt.ArrayLike) -> Floats32:
        """Map physical values, (n, d) or (d,), to mu of the same shape: the inverse of `physical`.

        The result is rounded to float32. It is in [-1, 1] if the values are in their ranges.
        """
        values = as_array(physical, "physical").astype(np.float64)
        share = (values - self._low) / (self._high - self._low)
        for i, parameter in self._logs:
            share[..., i] = parameter.shares(values[..., i])
        mu: Floats32 = (2.0 * share - 1.0).astype(np.float32)
        return mu

    def describe(self, mu: npt.ArrayLike) -> dict[str, float]:
        """Return the physical values of one mu, (d,), by name."""
        return dict(zip(self.names, map(float, self.physical(mu)), strict=True))

    def text(self, mu: npt.ArrayLike) -> str:
        """Write one mu, (d,), in words, such as `gravity 9.8, wind 3 m/s`."""
        values = zip(self.parameters, self.physical(mu).tolist(), strict=True)
        return ", ".join(parameter.text(value) for parameter, value in values)


def validate_mu(mu: npt.ArrayLike, dimension: int) -> Mu:
    """Return mu, an (n, dimension) batch inside [-1, 1], as contiguous float32: rounded once.

    Raises:
        ValueError: If mu is no array of real numbers, the shape is wrong, or a value is NaN or
            outside the box.
    """
    given = real_numbers(mu, "mu")
    with np.errstate(over="ignore"):  # what overflows float32 lies outside the box
        batch: npt.NDArray[Any] = np.ascontiguousarray(given, dtype=np.float32)
    if batch.ndim != 2 or batch.shape[1] != dimension:
        hint = f" Pass mu[None] for a single mu of shape ({dimension},)." if batch.ndim == 1 else ""
        raise UserError(f"Expected mu of shape (n, {dimension}), got {batch.shape}.{hint}")
    bad = ~(np.abs(batch) <= 1.0)  # a NaN is not <= 1 either
    if bad.any():
        row, column = map(int, np.argwhere(bad)[0])
        raise UserError(
            f"Expected mu within [-1, 1], got {batch[row, column]!s} at row {row}, column {column}."
            " Clip or rescale it; mu is normalised, not in physical units."
        )
    return batch
