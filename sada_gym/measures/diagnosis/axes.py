"""The cells that parameters' ranges are cut into, and the sets of cells that a rule may name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats, Indices
from sada_gym.measures.diagnosis.rounding import roundest
from sada_gym.parameters import Parameter, ParameterSpace

CELLS = 40
"""So many cells has a range of real numbers; of more choices or whole numbers some share a cell."""

_MANY, _MOST_SHARE = 10, 0.85
"""Of so many cells a condition names at most this share."""

_MOST_UNORDERED = 64
"""Of more choices without an order no rule can be found: each would have too few worlds."""

_MOST_WHOLE = 10_000
"""A range of more whole numbers is cut as one of real numbers."""


@dataclass(frozen=True, eq=False)
class Axis:
    """A parameter's range in cells, or that of a sum of two: `parameter + factor * other`.

    Attributes:
        index: The parameter's place among mu's columns.
        edges: (g + 1,) physical values; cell i lies between edges i and i + 1.
        other: The place of the other parameter; None where there is none.
        cyclic: Whether the last cell is beside the first.
        ordered: Whether a rule names neighbouring cells only.
        exact: Whether no threshold lies within a cell.
    """

    parameter: Parameter
    index: int
    edges: Floats
    cyclic: bool = False
    ordered: bool = True
    exact: bool = False
    other: int | None = None
    factor: float = 0.0

    @classmethod
    def of(cls, parameter: Parameter, index: int) -> Axis:
        """Cut a parameter's range."""
        low, high, count = parameter.low, parameter.high, len(parameter.choices)
        if count:
            ordered = is_ordered(parameter)
            if not ordered and count > _MOST_UNORDERED:
                return cls(parameter, index, np.array([low, high]), exact=True)
            edges = _thinned(np.linspace(low, high, count + 1))
            return cls(parameter, index, edges, ordered=ordered, exact=len(edges) == count + 1)
        if parameter.whole and high - low <= _MOST_WHOLE:
            edges = np.arange(low, high + 0.5)
            return cls(parameter, index, _thinned(edges), exact=len(edges) <= CELLS + 1)
        edges = parameter.values(np.linspace(0.0, 1.0, CELLS + 1))
        return cls(parameter, index, edges, cyclic=bool(parameter.directions))

    @classmethod
    def sum(cls, space: ParameterSpace, index: int, other: int, slope: float) -> Axis:
        """Cut the range of a sum, whose parts weigh 1 and `slope` as shares of their ranges.

        The one that weighs more comes first: a rule is solved for it.
        """
        if abs(slope) > 1.0:
            index, other, slope = other, index, 1.0 / slope
        first, second = space.parameters[index], space.parameters[other]
        exact = slope * (first.high - first.low) / (second.high - second.low)
        factor = float(f"{exact:.2g}")
        ends = sorted((factor * second.low, factor * second.high))
        edges = np.linspace(first.low + ends[0], first.high + ends[1], 2 * CELLS + 1)
        return cls(first, index, edges, other=other, factor=factor)

    def __len__(self) -> int:
        """Count the cells, g."""
        return len(self.edges) - 1

    def values(self, physical: Floats) -> Floats:
        """Return what is cut of physical values, (n, d): (n,)."""
        column: Floats = physical[:, self.index]
        return column if self.other is None else column + self.factor * physical[:, self.other]

    def cells(self, physical: Floats) -> Indices:
        """Return the cells of worlds with physical values, (n, d): (n,)."""
        return np.searchsorted(self.edges[1:-1], self.values(physical), side="right")

    def within(self, ranges: Sequence[tuple[float, float]], values: Floats) -> Bools:
        """Return which values, (n,), lie in one of some ranges, see `rules.in_ranges`."""
        found = np.zeros(len(values), np.bool_)
        for low, high in ranges:
            if self.cyclic:
                found |= (values - low) % 360.0 < high - low
            else:
                found |= (values >= low) & ((values < high) | (high >= self.edges[-1]))
        return found

    def span(self, cells: Bools) -> tuple[int, int]:
        """Return the first cell and the one after the last of an interval, as `intervals` does."""
        taken = np.flatnonzero(cells)
        gaps = np.flatnonzero(np.diff(taken) > 1)
        if not len(gaps):
            return int(taken[0]), int(taken[-1]) + 1
        return int(taken[gaps[0] + 1]), len(self) + int(taken[gaps[0]]) + 1

    def edge(self, stop: int) -> float:
        """Return where the cells before `stop` end; beyond the last it goes on all around."""
        g = len(self)
        return float(self.edges[stop] if stop <= g else self.edges[stop - g] + 360.0)

    def recut(self, thresholds: Floats) -> Axis:
        """Return the axis with edges at thresholds, (k,), in the place of the edges near them."""
        low, high = self.edges[0], self.edges[-1]
        ends = (thresholds - low) % 360.0 + low if self.cyclic else thresholds
        ends = np.unique(ends[(ends > low) & (ends < high)])
        if not len(ends):
            return self
        inner = self.edges[1:-1]
        place = np.searchsorted(self.edges, ends, side="right")
        half = 0.5 * (self.edges[place] - self.edges[place - 1])
        far = (np.abs(inner[:, None] - ends) > half).all(axis=1)
        return replace(self, edges=np.unique([low, *inner[far], *ends, high]))

    def round_within(self, low: float, high: float, near: float, guess: float) -> float:
        """Return the roundest threshold from low to high, and nearest `near` of such.

        `guess` is the end of a cell, and stays where thresholds lie between cells only.
        """
        if self.exact:
            return guess
        parameter = self.parameter
        if self.other is None and parameter.count:
            step = (parameter.high - parameter.low) / parameter.count  # between two values
            return parameter.low + step * round((near - parameter.low) / step)
        return roundest(low, high, near, angle=parameter.unit == "deg" and self.other is None)

    @property
    def intervals(self) -> tuple[Indices, Indices]:
        """The first cell and the one after the last of all intervals that a rule may name, (m,).

        Those that go beyond the last cell go on at the first one. Of many cells they leave some
        out: a condition that hardly excludes anything is hard to read.
        """
        g = len(self)
        return _intervals(g, self.cyclic, g - 1 if g < _MANY else int(_MOST_SHARE * g))


def _thinned(edges: Floats) -> Floats:
    kept = edges[:: -(-(len(edges) - 1) // CELLS)]
    return kept if kept[-1] == edges[-1] else np.append(kept, edges[-1])


@cache
def _intervals(count: int, cyclic: bool, most: int) -> tuple[Indices, Indices]:
    starts, sizes = np.meshgrid(np.arange(count), np.arange(1, most + 1), indexing="ij")
    stops = starts + sizes
    kept = np.ones(stops.shape, np.bool_) if cyclic else stops <= count
    return starts[kept], stops[kept]


def is_ordered(parameter: Parameter) -> bool:
    """Return whether a parameter's choices are consecutive whole numbers."""
    names = parameter.choices
    try:
        numbers = list(map(int, names))
    except ValueError:
        return False
    return numbers == list(range(numbers[0], numbers[0] + len(names)))
