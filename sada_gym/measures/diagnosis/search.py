"""Looks for boxes in which worlds fool the agent far more often than elsewhere.

That is subgroup discovery (Herrera et al. 2011), by boxes as in bump hunting (PRIM, Friedman and
Fisher 1999); but an interval is the best of all, and not what peeling leaves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats, Floats32, Indices
from sada_gym.measures.diagnosis.axes import Axis

MAX_CONDITIONS = 4
"""A rule with more of them is no answer."""

CONDITION_COST, LAST_COST = 4.0, 8.0
"""Log-likelihood that a condition must gain, and the last that is allowed: there are many to try.
A gain that is that large by chance is rejected by fresh worlds later."""

RULE_COST = 8.0
"""What a rule more costs."""

SUM_COST = 8.0
"""What a condition on a sum of two parameters costs beyond that: it is harder to read."""

OVERLAP_COST = 0.3
"""What each world that another box explains costs: boxes keep off one another."""

LEAST_LEAD = 0.2
"""A box fools at least this much more often than elsewhere."""

_FEW, _ROUNDS = 2, 3
_PROMISING, _SPLITS, _MOST_ALONE = 12, 12, 8
_RATE_ENDS = 0.003, 0.99
_STARTS, _STEPS_AT_ONCE = (12, 60), 3e6  # boxes; worlds times dimensions times boxes


@dataclass(frozen=True, eq=False)
class KnownWorlds:
    """Evaluated worlds: their cells by axes, (d, n), and whether each fooled the agent, (n,)."""

    cells: Indices
    fooled: Bools

    def __len__(self) -> int:
        """Count the worlds."""
        return len(self.fooled)


@dataclass(frozen=True, eq=False)
class Box:
    """The cells of each axis that a rule names.

    Attributes:
        cells: One (g,) for each axis.
        gain: How much more likely the worlds in it are under its own rate than under the rate
            elsewhere, as a logarithm, less the costs of its conditions.
    """

    cells: tuple[Bools, ...]
    gain: float = 0.0

    @cached_property
    def conditions(self) -> list[int]:
        """The axes that the rule names."""
        return [j for j, cells in enumerate(self.cells) if not cells.all()]

    def contains(self, worlds: KnownWorlds) -> Bools:
        """Return which worlds lie in it, (n,)."""
        inside = np.ones(len(worlds), np.bool_)
        for j in self.conditions:
            inside &= self.cells[j][worlds.cells[j]]
        return inside


class BoxSearch:
    """Finds the best box for the worlds that no box explains yet, from many starts at once.

    Coordinate ascent: along one axis after another each box takes the best interval of all, given
    its other conditions; or no condition, where none pays its cost. Of choices without an order
    it takes those that fail most.
    """

    def __init__(self, axes: Sequence[Axis], worlds: KnownWorlds, rng: np.random.Generator) -> None:
        self.axes, self.worlds, self._rng = axes, worlds, rng
        self._open = [j for j, axis in enumerate(axes) if len(axis) > 1]
        self._sums = [j for j in self._open if axes[j].other is not None]
        self._most = max(map(len, axes))
        starts = _STEPS_AT_ONCE / (max(len(worlds), 500) * max(len(self._open), 1))
        self._most_starts = int(np.clip(starts, *_STARTS))

    def best(self, elsewhere: float, covered: Bools) -> list[Box]:
        """Return boxes, the best first, given the rate elsewhere and the worlds explained, (n,)."""
        chosen = self._starts(covered)
        gain = self._ascend(chosen, elsewhere, covered, sweeps=2)
        chosen = chosen[np.argsort(-gain, kind="stable")[:_PROMISING]]
        gain = self._ascend(chosen, elsewhere, covered)
        order = np.argsort(-gain, kind="stable")
        boxes: list[Box] = []
        for row in order:
            box = self._box(chosen[row], float(gain[row]))
            if box.gain <= 0.0:
                break
            if not any(_same(box, other) for other in boxes):
                boxes.append(box)
        return boxes

    def improve(self, box: Box, elsewhere: float, covered: Bools) -> Box:
        """Ascend from a box."""
        chosen = self._padded(box)[None]
        gain = self._ascend(chosen, elsewhere, covered)
        return self._box(chosen[0], float(gain[0]))

    def wider(self, axis: Axis, cells: Indices) -> BoxSearch:
        """Return a search with one more axis, and the worlds' cells by it, (n,)."""
        worlds = KnownWorlds(np.vstack([self.worlds.cells, cells]), self.worlds.fooled)
        return BoxSearch([*self.axes, axis], worlds, self._rng)

    def _padded(self, box: Box) -> Bools:
        """Return the cells of a box, (d, g), of all axes as long as the longest."""
        padded = np.zeros((len(self.axes), self._most), np.bool_)
        for j, cells in enumerate(box.cells):
            padded[j, : len(cells)] = cells
        return padded

    def _box(self, chosen: Bools, gain: float) -> Box:
        return Box(tuple(chosen[j, : len(axis)].copy() for j, axis in enumerate(self.axes)), gain)

    def _starts(self, covered: Bools) -> Bools:
        """Return boxes of all sizes around failures, and the whole space, (b, d, g)."""
        failing = np.flatnonzero(self.worlds.fooled & ~covered)
        rows = self._rng.choice(failing, min(self._most_starts, len(failing)), replace=False)
        chosen = np.zeros((len(rows) + 1, len(self.axes), self._most), np.bool_)
        for j, axis in enumerate(self.axes):
            chosen[:, j, : len(axis)] = True
        sizes = self._rng.choice([0.3, 0.5, 0.7], len(rows))
        named = self._rng.choice([-1, *self._sums], len(rows))
        for j in self._open:
            axis = self.axes[j]
            g, at = len(axis), self.worlds.cells[j, rows]
            cells = np.arange(g)
            if axis.ordered:
                away = np.abs(cells - at[:, None])
                away = np.minimum(away, g - away) if axis.cyclic else away
                near = away <= np.maximum(0.5 * sizes * g, 0.5)[:, None]
            else:
                near = (cells == at[:, None]) | (self._rng.random((len(rows), 1)) < 0.5)
            free = named != j if j in self._sums else named >= 0
            chosen[1:, j, :g] = near | free[:, None]
        return chosen

    def halves(self, box: Box, elsewhere: float, covered: Bools) -> list[tuple[Box, Box]]:
        """Cut a box in two at many places, and improve each half as if the other were not there."""
        # along the axes that it names, and along others as far as time allows
        others = self._rng.permutation([j for j in self._open if j not in box.conditions])
        axes = [*box.conditions, *others.astype(int)]
        cuts = [(j, half) for j in axes for half in self._halves(j, box.cells[j])]
        cuts = cuts[: self._most_starts // 2]
        if not cuts:
            return []
        chosen = np.repeat(self._padded(box)[None], 2 * len(cuts), axis=0)
        inside = box.contains(self.worlds)
        seen = np.ones((2 * len(cuts), len(self.worlds)), np.bool_)
        for row, (j, half) in enumerate(cuts):
            chosen[2 * row, j] &= half
            chosen[2 * row + 1, j] &= ~half
            first = half[self.worlds.cells[j]]
            seen[2 * row] = ~inside | first
            seen[2 * row + 1] = ~inside | ~first
        gain = self._ascend(chosen, elsewhere, covered, seen, sweeps=2)
        halves = [self._box(row, float(one)) for row, one in zip(chosen, gain, strict=True)]
        return list(zip(halves[::2], halves[1::2], strict=True))

    def _halves(self, j: int, cells: Bools) -> list[Bools]:
        """Return parts of an axis' cells, each as long as all: some quarters, or one choice."""
        axis, parts = self.axes[j], []
        if axis.ordered:
            first, stop = axis.span(cells)
            places = {first + round(share * (stop - first)) for share in (0.25, 0.5, 0.75)}
            parts = [np.arange(first, place) % len(axis) for place in places - {first, stop}]
        elif cells.sum() > 1:
            parts = [np.array([cell]) for cell in np.flatnonzero(cells)[:_MOST_ALONE]]
        halves = np.zeros((len(parts), self._most), np.bool_)
        for half, part in zip(halves, parts, strict=True):
            half[part] = True
        return list(halves)

    def _ascend(
        self,
        chosen: Bools,
        elsewhere: float,
        covered: Bools,
        seen: Bools | None = None,
        sweeps: int = 10,
    ) -> Floats:
        """Improve boxes, (b, d, g), in place; return their gains, (b,).

        Each takes only the worlds that it has `seen`, (b, n).
        """
        worlds, b = self.worlds, len(chosen)
        value = Value(elsewhere)
        missed = np.zeros((b, len(worlds)), np.int16)
        for j in self._open:
            missed += ~chosen[:, j, worlds.cells[j]]
        is_named = ~np.stack(
            [chosen[:, j, : len(axis)].all(axis=1) for j, axis in enumerate(self.axes)], axis=1
        )
        kinds = np.stack([~covered, ~covered & worlds.fooled, covered])
        # a matrix pays for many boxes
        counters = {j: self._counter(j, kinds) for j in self._open} if b > _FEW else {}
        gain = np.full(b, -np.inf)
        loss = np.zeros((b, len(self.axes)))
        for sweep in range(sweeps):
            before = gain.copy()
            for j in self._rng.permutation(self._open):
                inside = chosen[:, j, worlds.cells[j]]
                others = (missed - ~inside) == 0
                if seen is not None:
                    others &= seen
                g = len(self.axes[j])
                if counters:
                    counts = (others.astype(np.float32) @ counters[j]).astype(np.float64)
                    counts = counts.reshape(b, 3, g)
                else:
                    counts = self._counts(j, kinds, others)
                number = is_named.sum(axis=1) - is_named[:, j]
                has_sum = is_named[:, [i for i in self._sums if i != j]].any(axis=1)
                cost = np.where(number < MAX_CONDITIONS - 1, CONDITION_COST, LAST_COST)
                if j in self._sums:
                    cost = cost + np.where(has_sum, np.inf, SUM_COST)
                whole = value(*counts.sum(axis=2).T)
                cells, best = best_cells(self.axes[j], counts, value)
                named = best - cost > whole
                chosen[:, j, :g] = np.where(named[:, None], cells, True)
                is_named[:, j] = named
                gain = np.where(named, best - cost, whole)
                gain = gain - self._costs(number) - SUM_COST * has_sum
                loss[:, j] = np.where(named, best - cost - whole, np.inf)
                missed += inside.astype(np.int16) - chosen[:, j, worlds.cells[j]]
            many = is_named.sum(axis=1) > MAX_CONDITIONS
            if 1 <= sweep < sweeps - 1 and many.any():
                for row in np.flatnonzero(many):
                    j = int(np.argmin(loss[row]))
                    missed[row] -= ~chosen[row, j, worlds.cells[j]]
                    chosen[row, j, : len(self.axes[j])] = True
                    is_named[row, j] = False
            elif (np.abs(gain - before) < 1e-6).all():
                break
        if sweeps > 2:
            gain[is_named.sum(axis=1) > MAX_CONDITIONS] = -np.inf
        return gain

    def cost(self, box: Box) -> float:
        """Return what a box's conditions cost."""
        number = len(box.conditions)
        last = number >= MAX_CONDITIONS
        sums = any(self.axes[j].other is not None for j in box.conditions)
        return CONDITION_COST * number + (LAST_COST - CONDITION_COST) * last + SUM_COST * sums

    def _costs(self, number: Indices) -> Floats:
        return CONDITION_COST * number + np.maximum(number - MAX_CONDITIONS + 1, 0) * (
            LAST_COST - CONDITION_COST
        )

    def _counter(self, j: int, kinds: Bools) -> Floats32:
        """Return the matrix, (n, 3 g), that counts worlds by kind and cell."""
        g = len(self.axes[j])
        counter = np.zeros((len(self.worlds), 3, g), np.float32)
        counter[np.arange(len(self.worlds)), :, self.worlds.cells[j]] = kinds.T
        return counter.reshape(len(self.worlds), 3 * g)

    def _counts(self, j: int, kinds: Bools, inside: Bools) -> Floats:
        """Count the worlds in each box, (b, n), by kind and cell: (b, 3, g)."""
        cells, g = self.worlds.cells[j], len(self.axes[j])
        counted = [
            [np.bincount(cells[rows & kind], minlength=g) for kind in kinds] for rows in inside
        ]
        return np.array(counted, np.float64)


@dataclass(frozen=True)
class Value:
    """The log-likelihood ratio of worlds in a box against the rate elsewhere, less overlaps."""

    elsewhere: float

    def __call__(self, worlds: Floats, fooled: Floats, covered: Floats) -> Floats:
        """Return the value of boxes with so many worlds, failures, and worlds of other boxes."""
        p0 = self.elsewhere
        rate = np.clip(fooled / np.maximum(worlds, 1.0), *_RATE_ENDS)
        ratio = fooled * np.log(rate / p0) + (worlds - fooled) * np.log((1 - rate) / (1 - p0))
        least = p0 + LEAST_LEAD * (1.0 - p0)
        return np.where(rate > least, ratio, 0.0) - OVERLAP_COST * covered


def best_cells(axis: Axis, counts: Floats, value: Value) -> tuple[Bools, Floats]:
    """Return the best set of cells for each box, (b, g), and its value, (b,)."""
    g = len(axis)
    if axis.ordered:
        starts, stops = axis.intervals
        kinds = np.moveaxis(counts, 1, 0)
        doubled = np.concatenate([kinds, kinds], axis=2) if axis.cyclic else kinds
        sums = np.concatenate([np.zeros((*kinds.shape[:2], 1)), doubled.cumsum(axis=2)], 2)
        inside = sums.take(stops, axis=2)
        inside -= sums.take(starts, axis=2)
        # of equal ones the narrowest
        values = value(*inside) - 1e-6 * (stops - starts)
        row = values.argmax(axis=1)
        cells = (np.arange(g) - starts[row, None]) % g < (stops - starts)[row, None]
        return cells, values.max(axis=1)
    order = np.argsort(-(counts[:, 1] + 0.1) / (counts[:, 0] + 1.0), axis=1, kind="stable")
    sums = np.take_along_axis(counts, order[:, None], axis=2).cumsum(axis=2)[:, :, :-1]
    values = value(*np.moveaxis(sums, 1, 0))
    size = values.argmax(axis=1) + 1
    rank = np.argsort(order, axis=1)
    return rank < size[:, None], values.max(axis=1)


def _same(box: Box, other: Box) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(box.cells, other.cells, strict=True))


def cover(search: BoxSearch, uniform: Bools, most: int, least_gain: float) -> list[Box]:
    """Find at most so many boxes, one after another.

    `uniform` says which worlds, (n,), were drawn evenly: the rate elsewhere is theirs.
    """
    boxes = grow(search, uniform, [], most, least_gain)
    best = total(search, uniform, boxes)
    tried: list[Box] = []
    for _ in range(_SPLITS):
        # merged weaknesses first: those that hold the most worlds which did not fool
        open_ = [box for box in boxes if not any(_same(box, other) for other in tried)]
        if not open_:
            break
        box = max(
            open_, key=lambda box: (box.contains(search.worlds) & ~search.worlds.fooled).sum()
        )
        tried.append(box)
        others = [other for other in boxes if other is not box]
        elsewhere = rate_elsewhere(search.worlds, uniform, boxes)
        pairs = search.halves(box, elsewhere, union(others, search.worlds))
        if not pairs:
            continue
        parts = [part for one, two in pairs for part in ([one], [two], [one, two])]
        totals = [total(search, uniform, [*others, *part]) for part in parts]
        if max(totals) <= best:
            continue
        part = parts[int(np.argmax(totals))]
        split = grow(search, uniform, [*others, *part], most, least_gain)
        if (found := total(search, uniform, split)) > best:
            boxes, best, tried = split, found, []
    return boxes


def grow(
    search: BoxSearch, uniform: Bools, boxes: list[Box], most: int, least_gain: float
) -> list[Box]:
    """Improve boxes and find further ones until none gains enough, or the last does not stay."""
    worlds, before = search.worlds, -1
    for _ in range(_ROUNDS * most):
        elsewhere = rate_elsewhere(worlds, uniform, boxes)
        boxes = settle(search, boxes, elsewhere, least_gain)
        if len(boxes) == before:
            return boxes
        before, covered = len(boxes), union(boxes, worlds)
        if len(boxes) == most or (worlds.fooled & ~covered).sum() < 5:
            return boxes
        elsewhere = rate_elsewhere(worlds, uniform, boxes)
        # without any box that rate counts all the failures that boxes will hold
        found = search.best(elsewhere if boxes else elsewhere / 2.0, covered)
        if not found or found[0].gain < least_gain:
            return boxes
        boxes = [*boxes, found[0]]
    return boxes


def prune(search: BoxSearch, uniform: Bools, boxes: list[Box]) -> list[Box]:
    """Drop boxes without which the worlds are as likely, the costs taken into account."""
    best = total(search, uniform, boxes)
    while boxes:
        fewer = [boxes[:i] + boxes[i + 1 :] for i in range(len(boxes))]
        totals = [total(search, uniform, left) for left in fewer]
        if max(totals) < best:
            break
        best, boxes = max(totals), fewer[int(np.argmax(totals))]
    return boxes


def total(search: BoxSearch, uniform: Bools, boxes: Sequence[Box]) -> float:
    """Return the log-likelihood of all worlds, each by its first box, less the boxes' costs."""
    worlds = search.worlds
    elsewhere = rate_elsewhere(worlds, uniform, boxes)
    left, found = np.ones(len(worlds), np.bool_), 0.0
    for box in sorted(boxes, key=lambda box: -box.gain):
        inside = box.contains(worlds)
        mine = worlds.fooled[inside & left]
        found += _log_likelihood(mine, float(mine.mean()) if len(mine) else 0.5)
        found -= OVERLAP_COST * float((inside & ~left).sum())
        found -= RULE_COST + search.cost(box)
        left &= ~inside
    return found + _log_likelihood(worlds.fooled[left], elsewhere)


def _log_likelihood(fooled: Bools, rate: float) -> float:
    rate, count = min(max(rate, _RATE_ENDS[0]), _RATE_ENDS[1]), int(fooled.sum())
    return count * math.log(rate) + (len(fooled) - count) * math.log(1.0 - rate)


def settle(search: BoxSearch, boxes: list[Box], elsewhere: float, least_gain: float) -> list[Box]:
    """Improve each box given the others, twice; drop those that gain too little."""
    boxes = list(boxes)
    for _ in range(2):
        for i in range(len(boxes)):
            others = union(boxes[:i] + boxes[i + 1 :], search.worlds)
            boxes[i] = search.improve(boxes[i], elsewhere, others)
        boxes = [box for box in boxes if box.gain >= least_gain]
    return boxes


def rate_elsewhere(worlds: KnownWorlds, uniform: Bools, boxes: Sequence[Box]) -> float:
    """Return the fooling rate of uniform worlds outside all boxes, within (0, 1)."""
    rows = uniform & ~union(boxes, worlds)
    return float(np.clip((worlds.fooled[rows].sum() + 0.5) / (rows.sum() + 1.0), 0.003, 0.9))


def union(boxes: Sequence[Box], worlds: KnownWorlds) -> Bools:
    """Return which worlds lie in any box, (n,)."""
    inside = np.zeros(len(worlds), np.bool_)
    for box in boxes:
        inside |= box.contains(worlds)
    return inside
