"""Where conditions hold, and worlds in which they do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.arrays import Bools, Floats
from sada_gym.measures.failure_regions import Condition
from sada_gym.parameters import Mu, Parameter, ParameterSpace


def holds(conditions: Sequence[Condition], space: ParameterSpace, mu: npt.ArrayLike) -> Bools:
    """Return for which mu, (n, d), all conditions hold, (n,).

    Raises:
        ValueError: If mu is not as `ParameterSpace.validate` takes it.
    """
    values = space.physical(space.validate(mu))
    inside = np.ones(len(values), np.bool_)
    for condition in conditions:
        index = space.names.index(condition.parameter)
        inside &= in_ranges(space.parameters[index], condition.ranges, values[:, index])
    return inside


def in_ranges(parameter: Parameter, ranges: Sequence[tuple[float, float]], values: Floats) -> Bools:
    """Return which physical values, (n,), lie in one of some ranges, low <= value < high, (n,).

    The high end of the parameter's own range belongs to it. Angles count all around: for them
    ranges may go beyond the parameter's ends, such as 150 to 210 degrees.
    """
    found = np.zeros(len(values), np.bool_)
    for low, high in ranges:
        if parameter.directions:
            found |= (values - low) % 360.0 < high - low
        else:
            found |= (values >= low) & ((values < high) | (high >= parameter.high))
    return found


def volume(conditions: Sequence[Condition], space: ParameterSpace) -> float:
    """Return the share of uniform worlds for which all conditions hold."""
    product = 1.0
    for condition in conditions:
        parameter = space.parameters[space.names.index(condition.parameter)]
        product *= float(_widths(parameter, condition.ranges)[1].sum())
    return product


def draw(
    conditions: Sequence[Condition], space: ParameterSpace, n: int, rng: np.random.Generator
) -> Mu:
    """Draw n worlds for which all conditions hold, uniform among these: (n, d)."""
    shares = rng.random((n, len(space)))
    for condition in conditions:
        index = space.names.index(condition.parameter)
        starts, widths = _widths(space.parameters[index], condition.ranges)
        ends = np.cumsum(widths)
        place = shares[:, index] * ends[-1]
        row = np.minimum(np.searchsorted(ends, place, side="right"), len(ends) - 1)
        shares[:, index] = (starts[row] + place - (ends[row] - widths[row])) % 1.0
    return np.clip(2.0 * shares - 1.0, -1.0, 1.0).astype(np.float32)


def _widths(parameter: Parameter, ranges: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    """Return where ranges start, as shares of the parameter's range, and how wide they are."""
    ends = np.array(ranges, np.float64)
    shares = parameter.shares(ends)
    return shares[:, 0], shares[:, 1] - shares[:, 0]
