"""Where conditions hold, and worlds in which they do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.measures.diagnosis.record import Condition, SumCondition
from sada_gym.parameters import Mu, Parameter, ParameterSpace

_VOLUME_DRAWS = 2**14
_LEAST_DRAWS, _MOST_ROUNDS = 1_000, 1_000


def holds(conditions: Sequence[Condition], space: ParameterSpace, mu: npt.ArrayLike) -> Bools:
    """Return whether all conditions hold for each mu, (n, d): (n,) bool.

    Raises:
        ValueError: If mu is not an (n, d) batch in [-1, 1].
    """
    values = space.physical(space.validate(mu))
    inside = np.ones(len(values), np.bool_)
    for condition in conditions:
        index = space.names.index(condition.parameter)
        if isinstance(condition, SumCondition):
            inside &= _sum_in_ranges(condition, space, values)
        else:
            inside &= in_ranges(space.parameters[index], condition.ranges, values[:, index])
    return inside


def _sum_in_ranges(condition: SumCondition, space: ParameterSpace, values: Floats) -> Bools:
    first, second = (space.names.index(name) for name in (condition.parameter, condition.other))
    total = values[:, first] + condition.factor * values[:, second]
    found = np.zeros(len(values), np.bool_)
    for low, high in condition.ranges:
        found |= (total >= low) & (total <= high)
    return found


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
    """Return the share of uniform worlds for which all conditions hold.

    For a sum of two parameters it is an estimate, from the same random worlds each time.
    """
    product = 1.0
    for condition in _single(conditions):
        parameter = space.parameters[space.names.index(condition.parameter)]
        product *= float(_widths(parameter, condition.ranges)[1].sum())
    if len(_single(conditions)) < len(conditions):
        drawn = _draw_single(conditions, space, _VOLUME_DRAWS, np.random.default_rng(0))
        product *= float(holds(conditions, space, drawn).mean())
    return product


def draw(
    conditions: Sequence[Condition], space: ParameterSpace, n: int, rng: np.random.Generator
) -> Mu:
    """Draw n worlds uniformly from those for which all conditions hold: (n, d).

    Raises:
        UserError: If they hold for hardly any world. This can happen with sums of two parameters.
    """
    drawn = _draw_single(conditions, space, n, rng)
    if len(_single(conditions)) == len(conditions):
        return drawn
    kept = [drawn[holds(conditions, space, drawn)]]
    for _ in range(_MOST_ROUNDS):
        if sum(map(len, kept)) >= n:
            return np.concatenate(kept)[:n]
        drawn = _draw_single(conditions, space, max(n, _LEAST_DRAWS), rng)
        kept.append(drawn[holds(conditions, space, drawn)])
    texts = [condition.text for condition in conditions]
    raise UserError(
        f"Expected conditions that worlds hold, got {texts}, which "
        "hardly any world holds. Widen their ranges."
    )


def _single(conditions: Sequence[Condition]) -> list[Condition]:
    return [condition for condition in conditions if not isinstance(condition, SumCondition)]


def _draw_single(
    conditions: Sequence[Condition], space: ParameterSpace, n: int, rng: np.random.Generator
) -> Mu:
    """Draw worlds for which the conditions on single parameters hold."""
    shares = rng.random((n, len(space)))
    for condition in _single(conditions):
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
