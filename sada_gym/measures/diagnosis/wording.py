"""Says rules as people do: `camera pitch is above 35° and the camera is behind`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.measures.diagnosis.axes import Axis
from sada_gym.measures.diagnosis.record import SumCondition, Threshold
from sada_gym.measures.diagnosis.thresholds import Ranges, Rule
from sada_gym.measures.failure_regions import Condition, condition, in_one_line, short_label
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
        return Condition(parameter=parameter.name, ranges=part.ranges, text=in_one_line(said))
    inner = {end for ends in part.ranges for end in ends} - {parameter.low, parameter.high}
    edges = np.array([parameter.low, *sorted(inner), parameter.high])
    if parameter.choices and not part.axis.ordered:
        edges = part.axis.edges
    middles = (edges[:-1] + edges[1:]) / 2.0
    return condition(parameter, edges, part.axis.within(part.ranges, middles))


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
        text=in_one_line(f"{first.label} is {where}"),
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
