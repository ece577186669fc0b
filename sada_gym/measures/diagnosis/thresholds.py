"""Turns boxes of cells into rules with round thresholds, each with an interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.measures.diagnosis.axes import Axis
from sada_gym.measures.diagnosis.search import Box

_WITHIN_95 = -math.log(1.0 - math.sqrt(0.95))
"""Thresholds that lose no more log-likelihood make an interval of 95 %: the place of a jump of a
rate is that far from the best on either side with a chance of exp(-loss) each (Siegmund 1988). The
roundest of them is taken."""

_STRONG = 0.25
"""Rules that gain at least this share of a rule's gain keep their worlds from it."""

_LEAST = 0.01
"""No rate within a rule, or elsewhere, counts as nearer to 0 or 1: one world proves little."""


@dataclass(frozen=True)
class End:
    """A threshold in physical values, and its interval of 95 %."""

    value: float
    interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Ranges:
    """What a rule says of one axis: the ranges, and the ends that are not ends of the axis."""

    axis: Axis
    ranges: tuple[tuple[float, float], ...]
    ends: tuple[End, ...] = ()

    @property
    def is_whole(self) -> bool:
        """Whether it holds everywhere: rounded ends may meet all around, or be the axis' own."""
        low, high = self.ranges[0][0], self.ranges[-1][1]
        whole = 360.0 if self.axis.cyclic else float(self.axis.edges[-1] - self.axis.edges[0])
        return len(self.ranges) == 1 and high - low >= whole

    def holds(self, physical: Floats) -> Bools:
        """Return for which worlds with physical values, (n, d), it holds, (n,)."""
        return self.axis.within(self.ranges, self.axis.values(physical))


Rule = tuple[Ranges, ...]
"""All of them hold."""


def holds(rule: Rule, physical: Floats) -> Bools:
    """Return for which worlds with physical values, (n, d), a rule holds, (n,)."""
    inside = np.ones(len(physical), np.bool_)
    for part in rule:
        inside &= part.holds(physical)
    return inside


def refine(
    axes: Sequence[Axis],
    boxes: Sequence[Box],
    physical: Floats,
    fooled: Bools,
    elsewhere: float,
    *,
    rounded: bool,
) -> list[Rule]:
    """Find the thresholds of boxes, given worlds, (n, d), and the rate elsewhere.

    They are the best, or the roundest that may be as good.
    """
    cells = [axis.cells(physical) for axis in axes]
    inside = [_contains(box, cells, len(physical)) for box in boxes]
    rules: list[Rule] = []
    for i, box in enumerate(boxes):
        # weak ones beside a strong one may be slivers of it, which cells could not hold
        strong = [inside[k] for k, other in enumerate(boxes) if other.gain >= _STRONG * box.gain]
        strong = [other for other in strong if other is not inside[i]]
        mine = ~np.logical_or.reduce([*strong, np.zeros_like(fooled)])
        rate = float(fooled[inside[i] & mine].mean()) if (inside[i] & mine).any() else 0.5
        gains = _gains(fooled, rate, elsewhere)
        parts: list[Ranges] = []
        for j in box.conditions:
            among = mine & _contains(box, cells, len(physical), without=j)
            values = axes[j].values(physical)[among]
            parts.append(_ranges(axes[j], box.cells[j], values, gains[among], rounded=rounded))
        rules.append(tuple(part for part in parts if not part.is_whole))
    return rules


def recut(
    axes: Sequence[Axis], rules: Sequence[Rule], gains: Sequence[float]
) -> tuple[list[Axis], list[Box]]:
    """Return axes with cells that end at the rules' thresholds, and the rules as boxes of these."""
    new = []
    for axis in axes:
        ends = [e.value for rule in rules for part in rule if part.axis is axis for e in part.ends]
        new.append(axis.recut(np.array(ends)) if ends and not axis.exact else axis)
    boxes = []
    for rule, gain in zip(rules, gains, strict=True):
        cells = [np.ones(len(axis), np.bool_) for axis in new]
        for part in rule:
            j = next(j for j, axis in enumerate(axes) if axis is part.axis)
            middles = (new[j].edges[:-1] + new[j].edges[1:]) / 2.0
            cells[j] = axes[j].within(part.ranges, middles)
        boxes.append(Box(tuple(cells), gain))
    return new, boxes


def _contains(
    box: Box, cells: Sequence[np.ndarray], count: int, without: int | None = None
) -> Bools:
    inside = np.ones(count, np.bool_)
    for j in box.conditions:
        if j != without:
            inside &= box.cells[j][cells[j]]
    return inside


def _gains(fooled: Bools, rate: float, elsewhere: float) -> Floats:
    """Return the log-likelihood that each world gains in the rule, (n,)."""
    low = max(elsewhere, _LEAST)
    rate = min(max(rate, low + _LEAST), 1.0 - _LEAST)
    return np.where(fooled, math.log(rate / low), math.log((1.0 - rate) / (1.0 - low)))


def _ranges(axis: Axis, cells: Bools, values: Floats, gains: Floats, *, rounded: bool) -> Ranges:
    edges = axis.edges
    if not axis.ordered:
        taken = np.flatnonzero(cells)
        return Ranges(axis, tuple((float(edges[i]), float(edges[i + 1])) for i in taken))
    first, stop = axis.span(cells)
    low, high = float(edges[first]), float(axis.edge(stop))
    order = np.argsort(values, kind="stable")
    values, gains = values[order], gains[order]
    around = 360.0 if axis.cyclic else 0.0
    if axis.cyclic:  # as seen from the middle of the range
        middle = (low + high) / 2.0
        values = (values - middle + 180.0) % 360.0 + middle - 180.0
        order = np.argsort(values, kind="stable")
        values, gains = values[order], gains[order]
    middle = (low + high) / 2.0
    below, above = values < middle, values >= middle
    ends: list[End] = []
    if axis.cyclic or first > 0:
        limit = middle - 180.0 if around else float(edges[0])
        end = _end(
            axis,
            values[below],
            gains[below],
            (limit, middle),
            low,
            from_below=True,
            rounded=rounded,
        )
        low = limit if end is None else end.value
        ends += [] if end is None else [end]
    if axis.cyclic or stop < len(axis):
        limit = middle + 180.0 if around else float(edges[-1])
        end = _end(
            axis,
            values[above],
            gains[above],
            (middle, limit),
            high,
            from_below=False,
            rounded=rounded,
        )
        high = limit if end is None else end.value
        ends += [] if end is None else [end]
    return Ranges(axis, ((low, high),), tuple(ends))


def _end(
    axis: Axis,
    values: Floats,
    gains: Floats,
    limits: tuple[float, float],
    guess: float,
    *,
    from_below: bool,
    rounded: bool,
) -> End | None:
    """Find an end by worlds with sorted values between limits, one of which is the rule's middle.

    A rule that begins at a value has the worlds above it. None where the range may as well go on
    to its limit.
    """
    places = np.concatenate([[limits[0]], values, [limits[1]]])
    sums = np.concatenate([[0.0], gains.cumsum()])
    likely = sums[-1] - sums if from_below else sums  # of an end in each gap between two worlds
    best = int(likely.argmax())
    sure = np.flatnonzero(likely >= likely[best] - _WITHIN_95)
    at_limit = sure[0] == 0 if from_below else sure[-1] == len(likely) - 1
    if at_limit and not axis.cyclic:
        return None
    low, high = float(places[sure[0]]), float(places[sure[-1] + 1])
    gap = float(places[best]), float(places[best + 1])
    # where no world tells, other rules may have taken them: it stays
    wide = gap[1] - gap[0] > axis.edges[1] - axis.edges[0]
    middle = min(max(guess, gap[0]), gap[1]) if wide else sum(gap) / 2.0
    value = axis.round_within(low, high, middle, guess) if rounded else middle
    return End(value, (low, high))
