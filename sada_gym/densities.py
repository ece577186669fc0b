"""How likely worlds are in ordinary use: densities of parameters, as data.

A density belongs to a parameter's physical values, and is cut off at the ends of its range. That of
an angle that goes all around is wrapped: 350 degrees are -10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Mu, Parameter, ParameterSpace

_NUMBERS = {"normal": 2, "uniform": 2, "truncated-normal": 4}
_FORMS = (
    '{"normal": [mean, sd]}, {"uniform": [low, high]}, {"truncated-normal": [mean, sd, low, high]} '
    'or {"values": [...], "weights": [...]}'
)
_CELLS = 4_096
"""Parts of a continuous range, in each of which a density counts as even."""
_TURNS = 20
"""An angle's density is summed over so many turns on both sides of its centre."""
_MOST_COUNTED = 65_536
"""Whole numbers of a longer range count as continuous."""
_LEAST = 1e-3
"""The least share of a density that a range must hold."""


@dataclass(frozen=True)
class Density:
    """A density of one parameter.

    Attributes:
        data: `{"normal": [mean, sd]}`, `{"uniform": [low, high]}`, `{"truncated-normal": [mean, sd,
            low, high]}`, or `{"values": [...], "weights": [...]}`: of choices and whole numbers the
            weights are those of each, otherwise the density is linear between the values, and 0
            outside.

    Raises:
        UserError: If the data are none of these.
    """

    data: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Check the data."""
        data = self.data if isinstance(self.data, Mapping) else {}
        pairs: list[tuple[str, Any]] = [*data.items(), ("", None)]
        kind, numbers = pairs[0]
        if not data:
            right = False
        elif self.is_table:
            values, weights = self.data["values"], self.data["weights"]
            lists = isinstance(values, list | tuple) and _are_finite(weights, len(values))
            right = lists and min(weights, default=-1.0) >= 0.0 and sum(weights) > 0.0
        elif len(self.data) != 1 or not _are_finite(numbers, _NUMBERS.get(kind, -1)):
            right = False
        elif kind == "uniform":
            right = numbers[0] < numbers[1]
        else:
            right = numbers[1] > 0.0 and (kind == "normal" or numbers[2] < numbers[3])
        if not right:
            raise UserError(
                f"Expected a density as {_FORMS}, with low < high, sd above 0, and as many weights "
                f"as values, none below 0 and one above; got {self.data!r}."
            )

    @property
    def is_table(self) -> bool:
        """Whether it is a table of values and weights."""
        return {*self.data} == {"values", "weights"}

    @property
    def centre(self) -> Any:
        """The mean, the middle, or the value of the highest weight; the nearest one allowed."""
        if self.is_table:
            return self.data["values"][int(np.argmax(self.data["weights"]))]
        ((kind, numbers),) = self.data.items()
        if kind == "uniform":
            return (numbers[0] + numbers[1]) / 2.0
        return float(np.clip(numbers[0], *numbers[2:])) if numbers[2:] else float(numbers[0])

    @property
    def ends(self) -> tuple[float, ...]:
        """The numbers outside which it is 0, if there are some."""
        if self.is_table:
            return (self.data["values"][0], self.data["values"][-1])
        ((kind, numbers),) = self.data.items()
        return tuple(numbers) if kind == "uniform" else tuple(numbers[2:])

    def below(self, values: Floats) -> Floats:
        """Return the probability of a number of at most each of some, of the same shape."""
        if self.is_table:
            return self._below_in_table(values)
        from scipy.special import ndtr

        ((kind, numbers),) = self.data.items()
        if kind == "uniform":
            low, high = numbers
            return np.asarray(np.clip((values - low) / (high - low), 0.0, 1.0))
        mean, sd, *ends = numbers
        probability = ndtr((values - mean) / sd)
        if ends:
            first, last = ndtr((np.array(ends) - mean) / sd)
            with np.errstate(divide="ignore", invalid="ignore"):  # ends far out in a tail
                probability = np.nan_to_num(np.clip((probability - first) / (last - first), 0, 1))
        return np.asarray(probability)

    def _below_in_table(self, values: Floats) -> Floats:
        at, height = (np.array(self.data[key], np.float64) for key in ("values", "weights"))
        steps = np.diff(at)
        before = np.concatenate([[0.0], np.cumsum(steps * (height[1:] + height[:-1]) / 2.0)])
        inside = np.clip(values, at[0], at[-1])
        i = np.clip(np.searchsorted(at, inside, side="right") - 1, 0, len(steps) - 1)
        step, slope = inside - at[i], np.diff(height)[i] / steps[i]
        return np.asarray((before[i] + step * (height[i] + slope * step / 2.0)) / before[-1])


class WorldDensity:
    """How likely worlds are in ordinary use: parameters are independent.

    Args:
        space: The parameters.
        densities: The densities of some of them by name; the others are uniform in mu.

    Raises:
        UserError: If a parameter's range holds hardly any of its density, or a table does not fit.
    """

    def __init__(self, space: ParameterSpace, densities: Mapping[str, Density]) -> None:
        self.space, self.densities = space, dict(densities)
        self._cells = [
            _Cells.of(parameter, self.densities.get(parameter.name))
            for parameter in space.parameters
        ]

    @property
    def data(self) -> dict[str, Any]:
        """The densities by name, as data for JSON."""
        return {name: dict(density.data) for name, density in self.densities.items()}

    @property
    def held(self) -> float:
        """The share of the density that lies in the ranges."""
        return float(np.prod([cells.held for cells in self._cells]))

    def log_density(self, mu: Mu) -> Floats:
        """Return the logarithm of the density over [-1, 1]^d at mu, (n, d): (n,), maybe -inf."""
        shares = (mu.astype(np.float64) + 1.0) / 2.0
        columns = zip(self._cells, shares.T, strict=True)
        logs = np.array([cells.log_density(column) for cells, column in columns])
        return np.asarray(logs.sum(axis=0) - len(self._cells) * np.log(2.0))

    @property
    def highest(self) -> float:
        """The greatest value of `log_density`."""
        with np.errstate(divide="ignore"):
            each = [np.log(one.masses / np.diff(one.edges)).max() for one in self._cells]
        return float(np.sum(each) - len(each) * np.log(2.0))

    def from_normal(self, z: Floats) -> Mu:
        """Map standard normal numbers, (n, d), to mu, (n, d), that are as in ordinary use."""
        from scipy.special import ndtr

        columns = zip(self._cells, ndtr(z).T, strict=True)
        shares = np.stack([cells.at(column) for cells, column in columns], axis=1)
        return (2.0 * shares - 1.0).astype(np.float32)

    def to_normal(self, mu: Mu) -> Floats:
        """Return numbers that `from_normal` maps to mu, (n, d), maybe infinite ones."""
        from scipy.special import ndtri

        columns = zip(self._cells, (mu.T.astype(np.float64) + 1.0) / 2.0, strict=True)
        below = np.stack([cells.below(column) for cells, column in columns], axis=1)
        return np.asarray(ndtri(np.clip(below, 0.0, 1.0)))

    def sample(self, count: int, rng: np.random.Generator) -> Mu:
        """Draw worlds as they are in ordinary use, (count, d)."""
        shares = np.stack([cells.sample(count, rng) for cells in self._cells], axis=1)
        return (2.0 * shares - 1.0).astype(np.float32)


@dataclass(frozen=True)
class _Cells:
    """A density over a range: probabilities of parts of it, in each of which it is even."""

    edges: Floats  # (k + 1,) shares of the range
    masses: Floats  # (k,), whose sum is 1
    held: float  # the share of the density in the range

    @classmethod
    def of(cls, parameter: Parameter, density: Density | None) -> _Cells:
        if density is None:
            return cls(np.array([0.0, 1.0]), np.ones(1), 1.0)
        count = round(parameter.high - parameter.low)
        is_counted = bool(parameter.choices) or (parameter.whole and count <= _MOST_COUNTED)
        if is_counted:
            edges = parameter.low + np.arange(count + 1.0)
        else:
            edges = parameter.values(np.linspace(0.0, 1.0, _CELLS + 1))
        if density.is_table and is_counted:
            masses = _counted(parameter, density)
        elif parameter.choices and not parameter.whole:
            raise UserError(
                f"Expected a table of values and weights as the density of {parameter.name!r}, "
                f"whose values are {', '.join(parameter.choices)}; got {dict(density.data)!r}."
            )
        else:
            _check_numbers(parameter, density)
            ends, turns = density.ends, [0.0]
            if parameter.directions:
                low, around = parameter.low, np.arange(-_TURNS, _TURNS + 1.0)
                turns = (360.0 * ((density.centre - low) // 360.0 + around)).tolist()
                ends = tuple(low + (end - low) % 360.0 for end in ends)
            if not is_counted:
                edges = _with_ends(edges, ends)
            masses = np.sum([np.diff(density.below(edges + turn)) for turn in turns], axis=0)
        held = float(masses.sum())
        if not held >= _LEAST:
            raise UserError(
                f"Expected the range of {parameter.name!r} to hold a thousandth of its density at "
                f"least, got {held:.2g} of {dict(density.data)!r}. Widen the range."
            )
        return cls(parameter.shares(edges), masses / held, held)

    def log_density(self, shares: Floats) -> Floats:
        i = np.clip(np.searchsorted(self.edges, shares, side="right") - 1, 0, len(self.masses) - 1)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.masses / np.diff(self.edges))[i])

    def below(self, shares: Floats) -> Floats:
        """Return the probability below each share of the range, of the same shape."""
        heights = np.append(0.0, np.cumsum(self.masses))
        return np.asarray(np.interp(shares, self.edges, heights))

    def at(self, probability: Floats) -> Floats:
        """Return the share of the range below which lies so much: the inverse of `below`."""
        ends = np.cumsum(self.masses)
        i = np.searchsorted(ends, np.minimum(probability, ends[-1]), side="left")
        inside = 1.0 - (ends[i] - np.minimum(probability, ends[-1])) / self.masses[i]
        return np.asarray(self.edges[i] + np.diff(self.edges)[i] * np.clip(inside, 0.0, 1.0))

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        i = rng.choice(len(self.masses), count, p=self.masses)
        return np.asarray(self.edges[i] + np.diff(self.edges)[i] * rng.random(count))


def _with_ends(edges: Floats, ends: tuple[float, ...]) -> Floats:
    """Put the ends of a density among the edges of cells: no cell lies partly outside."""
    inside = [end for end in ends if edges[0] < end < edges[-1]]
    nearest = np.diff(edges).min() * 1e-6  # a cell has some width
    for end in inside:
        edges = np.append(edges[np.abs(edges - end) > nearest], end)
    return np.unique(edges)


def _counted(parameter: Parameter, density: Density) -> Floats:
    """Return the probability of each choice or whole number, of those in the range."""
    names = parameter.choices or range(round(parameter.low + 0.5), round(parameter.high + 0.5))
    places = {str(name): i for i, name in enumerate(names)}
    masses = np.zeros(len(places))
    weights = np.array(density.data["weights"], np.float64)
    for value, weight in zip(density.data["values"], weights / weights.sum(), strict=True):
        name = str(int(value)) if parameter.whole and _is_whole(value) else str(value)
        if name in places:
            masses[places[name]] += weight
        elif parameter.choices and not parameter.whole:
            raise UserError(
                f"Expected values of the density of {parameter.name!r} among "
                f"{', '.join(parameter.choices)}, got {value!r}."
            )
    return masses


def _check_numbers(parameter: Parameter, density: Density) -> None:
    values = density.data.get("values", (0.0, 1.0))
    if not _are_finite(values, len(values)) or not np.all(np.diff(values) > 0.0) or len(values) < 2:
        raise UserTypeError(
            f"Expected at least two values of the density of {parameter.name!r}, numbers in "
            f"ascending order, got {values!r}."
        )


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | float) and float(value).is_integer()


def _are_finite(numbers: Any, count: int) -> bool:
    if not isinstance(numbers, list | tuple) or len(numbers) != count:
        return False
    kinds = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
    return kinds and bool(np.isfinite(np.array(numbers, np.float64)).all())
