"""Says rules as people do: `camera pitch is above 35° and the camera is behind`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sada_gym.errors import plain
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.figures import number
from sada_gym.measures.diagnosis.axes import Axis, is_ordered
from sada_gym.measures.diagnosis.record import Condition, SumCondition, Threshold
from sada_gym.measures.diagnosis.thresholds import Ranges, Rule
from sada_gym.parameters import Parameter, ParameterSpace


def conditions(space: ParameterSpace, rule: Rule) -> tuple[Condition | SumCondition, ...]:
    """Return the conditions of a rule, in the order of the parameters."""
    ordered = sorted(rule, key=lambda part: (part.axis.index, part.axis.other or -1))
    return tuple(_condition(space, part) for part in ordered)


def listed(said: Sequence[Condition | SumCondition]) -> str:
    """Join conditions that all hold."""
    return " and ".join(condition.text for condition in said)


def thresholds(space: ParameterSpace, rule: Rule) -> tuple[Threshold, ...]:
    """Return the ends of a rule's ranges, with their intervals."""

    def name(axis: Axis) -> str:
        if axis.other is None:
            return axis.parameter.name
        sign, times = "-" if axis.factor < 0.0 else "+", abs(axis.factor)
        return f"{axis.parameter.name} {sign} {times:g} {space.names[axis.other]}"

    return tuple(
        Threshold(parameter=name(part.axis), value=end.value, interval_95=end.interval)
        for part in sorted(rule, key=lambda part: part.axis.index)
        for end in part.ends
    )


def _condition(space: ParameterSpace, part: Ranges) -> Condition | SumCondition:
    parameter = part.axis.parameter
    if part.axis.other is not None:
        return _sum(space, part, part.axis.other)
    if part.axis.cyclic:
        [(low, high)] = part.ranges
        said = f"{short_label(parameter)} is {_around(parameter, low, high)}"
        return Condition(parameter=parameter.name, ranges=part.ranges, text=plain(said))
    inner = {end for ends in part.ranges for end in ends} - {parameter.low, parameter.high}
    edges = np.array([parameter.low, *sorted(inner), parameter.high])
    if parameter.choices and not part.axis.ordered:
        edges = part.axis.edges
    middles = (edges[:-1] + edges[1:]) / 2.0
    return _of_cells(parameter, edges, part.axis.within(part.ranges, middles))


def _of_cells(parameter: Parameter, edges: Floats, cells: Bools) -> Condition:
    """Return the condition that a parameter lies in some cells of its range, (k,).

    Cell i lies between the physical values i and i + 1 of `edges`, (k + 1,).
    """
    said = f"{short_label(parameter)} is {_describe(parameter, edges, cells)}"
    ranges = tuple((float(edges[i]), float(edges[j])) for i, j in _runs(cells))
    return Condition(parameter=parameter.name, ranges=ranges, text=plain(said))


def short_label(parameter: Parameter) -> str:
    """Say what it is whose parameter is said: the camera, where it is the camera's azimuth."""
    return parameter.label.removesuffix(" azimuth") if parameter.directions else parameter.label


def _runs(cells: Bools) -> list[tuple[int, int]]:
    changes = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(np.int8), [0]])))
    return [(int(i), int(j)) for i, j in changes.reshape(-1, 2)]


def _describe(parameter: Parameter, edges: Floats, cells: Bools) -> str:
    names = parameter.choices
    if names and not is_ordered(parameter):
        chosen = [name for name, taken in zip(names, cells, strict=True) if taken]
        others = [name for name, taken in zip(names, cells, strict=True) if not taken]
        return _either(chosen) if len(chosen) <= len(others) else f"not {_either(others)}"
    if names:
        share = (edges - parameter.low) / (parameter.high - parameter.low)
        first = np.rint(share * len(names)).astype(int).tolist()  # each cell's first choice
        return _either([_choices(names, first[i], first[j]) for i, j in _runs(cells)])
    if parameter.whole:
        ends = [parameter.with_unit(number(math.ceil(edge))) for edge in edges]
        lasts = [parameter.with_unit(number(math.floor(edge))) for edge in edges]
        return _either([_whole(ends, lasts, i, j) for i, j in _runs(cells)])
    # edges are round numbers; those of a narrow range far from zero need many digits
    rounded = (f"{edge:.12g}".replace("-", "\N{MINUS SIGN}") for edge in edges)
    ends = [parameter.with_unit(text) for text in rounded]
    return _either([_interval(ends, i, j) for i, j in _runs(cells)])


def _choices(names: tuple[str, ...], first: int, stop: int) -> str:
    if stop == first + 1:
        return names[first]
    if first == 0:
        return f"at most {names[stop - 1]}"
    if stop == len(names):
        return f"at least {names[first]}"
    return f"{names[first]} to {names[stop - 1]}"


def _whole(starts: list[str], stops: list[str], first: int, last: int) -> str:
    if starts[first] == stops[last]:
        return starts[first]
    if first == 0:
        return f"at most {stops[last]}"
    if last == len(stops) - 1:
        return f"at least {starts[first]}"
    return f"{starts[first]} to {stops[last]}"


def _interval(ends: list[str], first: int, last: int) -> str:
    if first == 0:
        return f"below {ends[last]}"
    if last == len(ends) - 1:
        return f"above {ends[first]}"
    return f"between {ends[first]} and {ends[last]}"


def _either(parts: Sequence[str]) -> str:
    """Join what may be said of one thing: `fog, rain or snow`."""
    return " or ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _sum(space: ParameterSpace, part: Ranges, other: int) -> SumCondition:
    """Say a condition on a sum solved for its first part: `speed is below 78 + turbulence`."""
    first, second, factor = part.axis.parameter, space.parameters[other], part.axis.factor
    times = "" if abs(factor) == 1.0 else f"{_plain(abs(factor))} \N{MULTIPLICATION SIGN} "
    term = f"{times}{second.label}"

    def end(value: float) -> str:
        if value == 0.0:
            return term if factor < 0.0 else f"\N{MINUS SIGN}{term}"
        sign = "+" if factor < 0.0 else "\N{MINUS SIGN}"
        return f"{first.with_unit(_plain(value))} {sign} {term}"

    [(low, high)] = part.ranges
    if low <= part.axis.edges[0]:
        where = f"below {end(high)}"
    elif high >= part.axis.edges[-1]:
        where = f"above {end(low)}"
    else:
        where = f"between {end(low)} and {end(high)}"
    return SumCondition(
        parameter=first.name,
        other=second.name,
        factor=factor,
        ranges=part.ranges,
        text=plain(f"{first.label} is {where}"),
    )


def _around(parameter: Parameter, low: float, high: float) -> str:
    """Say a range of an angle in words and in degrees of the parameter's own range."""
    names, width = parameter.directions, high - low
    middle = (low + high) / 2.0
    prefix = ""
    if width > 180.0:
        prefix, middle = "not ", middle + 180.0
    eighth = round(middle / 45.0) % 8
    if eighth % 2:
        ahead, aside = sorted(((eighth // 2) % 4, (eighth // 2 + 1) % 4), key=lambda i: i % 2)
        name = f"{names[ahead]} and {names[aside]}"
    else:
        name = names[eighth // 2]
    first, last = (_wrapped(parameter, end) for end in (low, high))
    if first == -last and first > last:
        degrees = f"beyond ±{_plain(first)}°"
    elif last == parameter.low:
        degrees = f"{_plain(first)}° to {_plain(parameter.high)}°"
    elif first > last:
        degrees = f"above {_plain(first)}° or below {_plain(last)}°"
    else:
        degrees = f"{_plain(first)}° to {_plain(last)}°"
    return f"{prefix}{name} ({degrees})"


def _wrapped(parameter: Parameter, angle: float) -> float:
    turned = (angle - parameter.low) % 360.0 + parameter.low
    return float(f"{turned:.12g}")


def _plain(value: float) -> str:
    # rounded already; a value of a narrow range far from zero needs many digits
    return f"{value:.12g}".replace("-", "\N{MINUS SIGN}")
