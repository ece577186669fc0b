"""Puts slanted bands in the place of boxes that cover them in steps, and where no box is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.measures.diagnosis.axes import Axis
from sada_gym.measures.diagnosis.search import (
    CONDITION_COST,
    RULE_COST,
    SUM_COST,
    Box,
    BoxSearch,
    prune,
    rate_elsewhere,
    total,
    union,
)
from sada_gym.measures.diagnosis.sums import SLOPES, best_alone, pairs
from sada_gym.parameters import ParameterSpace

_FINER = 2.0 ** (np.arange(-3, 4) / 16.0)
"""The slopes tried around one of `SLOPES`, as shares of it."""

_MOST_TRIED, _MOST_BANDS = 10, 5


@dataclass(frozen=True, eq=False)
class _Band:
    """A band along `parameter + slope * other` for worlds in no box, or in `replaced` ones only.

    Attributes:
        lead: How much more it gains than those.
    """

    pair: tuple[int, int]
    slope: float
    replaced: Sequence[Box]
    lead: float


def banded(
    space: ParameterSpace, physical: Floats, search: BoxSearch, uniform: Bools, boxes: list[Box]
) -> tuple[BoxSearch, list[Box]]:
    """Put bands in the place of boxes, or beside them, as long as that explains more.

    Returns:
        A search with the bands' sums among its axes, and the boxes.
    """
    best = total(search, uniform, boxes)
    for _ in range(_MOST_BANDS):
        bands = sorted(_bands(space, physical, search, uniform, boxes), key=lambda b: -b.lead)
        for band in bands[:_MOST_TRIED]:
            wider, plans = _placed(space, physical, search, uniform, boxes, band)
            totals = [total(wider, uniform, plan) for plan in plans]
            if max(totals, default=best) > best:
                best = max(totals)
                search, boxes = wider, plans[totals.index(best)]
                break
        else:
            break
    return search, boxes


def _bands(
    space: ParameterSpace, physical: Floats, search: BoxSearch, uniform: Bools, boxes: Sequence[Box]
) -> Iterator[_Band]:
    """Find the best band of each pair beside all boxes, and in the place of the weakest ones.

    Only boxes that name both parameters may be replaced.
    """
    elsewhere = rate_elsewhere(search.worlds, uniform, boxes)
    for pair in pairs(space):
        axes = [Axis.sum(space, *pair, slope) for slope in SLOPES]
        both = [box for box in boxes if set(pair) <= _named(search, box)]
        both.sort(key=lambda box: box.gain)
        for count in range(len(both) + 1):
            covered = union([b for b in boxes if b not in both[:count]], search.worlds)
            _, gains = best_alone(axes, physical, search.worlds.fooled, covered, elsewhere)
            lost = sum(box.gain - RULE_COST for box in both[:count])
            slope = SLOPES[int(gains.argmax())]
            yield _Band(pair, slope, both[:count], float(gains.max()) - lost)


def _named(search: BoxSearch, box: Box) -> set[int | None]:
    return {i for k in box.conditions for i in (search.axes[k].index, search.axes[k].other)}


def _placed(
    space: ParameterSpace,
    physical: Floats,
    search: BoxSearch,
    uniform: Bools,
    boxes: Sequence[Box],
    band: _Band,
) -> tuple[BoxSearch, list[list[Box]]]:
    """Return a search with a band's sum, and two plans: without the replaced boxes and with them.

    Boxes that the band makes needless are gone. There is no plan where the band is too weak.
    """
    elsewhere = rate_elsewhere(search.worlds, uniform, boxes)
    left = [box for box in boxes if box not in band.replaced]
    covered = union(left, search.worlds)
    axes = [Axis.sum(space, *band.pair, band.slope * finer) for finer in _FINER]
    cells, gains = best_alone(axes, physical, search.worlds.fooled, covered, elsewhere)
    k = int(gains.argmax())
    if gains[k] < CONDITION_COST + SUM_COST:
        return search, []
    wider = search.wider(axes[k], axes[k].cells(physical))
    whole = [np.ones(len(axis), np.bool_) for axis in wider.axes]
    new = wider.improve(Box((*whole[:-1], cells[k])), elsewhere, covered)
    return wider, [
        prune(wider, uniform, [*(Box((*b.cells, whole[-1]), b.gain) for b in kept), new])
        for kept in ([left, boxes] if band.replaced else [left])
    ]
