"""Finds pairs of parameters that matter together: failures lie along a slanted band."""

from __future__ import annotations

import numpy as np

from sada_gym.arrays import Bools, Floats
from sada_gym.diagnosis.axes import Axis
from sada_gym.diagnosis.search import SUM_COST, Value
from sada_gym.parameters import Parameter, ParameterSpace

_SLOPES = (-2.0, -1.4, -1.0, -0.7, -0.5, 0.5, 0.7, 1.0, 1.4, 2.0)
_MOST_SUMS = 4
_MOST_PARAMETERS = 24
"""Of more parameters there are too many pairs."""


def sums(space: ParameterSpace, physical: Floats, fooled: Bools, elsewhere: float) -> list[Axis]:
    """Return axes of sums of two parameters along which failures crowd more than along either."""
    if len(space) > _MOST_PARAMETERS:
        return []
    plain = [i for i, p in enumerate(space.parameters) if _is_plain(p)]
    single = {
        i: _best_alone(Axis.of(space.parameters[i], i), physical, fooled, elsewhere) for i in plain
    }
    found: list[tuple[float, Axis]] = []
    for n, i in enumerate(plain):
        for j in plain[n + 1 :]:
            if space.parameters[i].unit != space.parameters[j].unit:
                continue  # metres and degrees make no sum
            tried = []
            for slope in _SLOPES:
                axis = Axis.sum(space, i, j, slope)
                tried.append((_best_alone(axis, physical, fooled, elsewhere), axis))
            gain, axis = max(tried, key=lambda pair: pair[0])
            if gain > max(single[i], single[j]) + SUM_COST:
                found.append((gain - max(single[i], single[j]), axis))
    found.sort(key=lambda pair: -pair[0])
    return [axis for _, axis in found[:_MOST_SUMS]]


def _best_alone(axis: Axis, physical: Floats, fooled: Bools, elsewhere: float) -> float:
    cells, g = axis.cells(physical), len(axis)
    counts = np.stack([np.bincount(cells, minlength=g), np.bincount(cells[fooled], minlength=g)])
    before = np.concatenate([np.zeros((2, 1)), counts.cumsum(axis=1)], axis=1)
    starts, stops = axis.intervals
    inside = before[:, stops] - before[:, starts]
    return float(Value(elsewhere)(inside[0], inside[1], np.zeros(len(starts))).max())


def _is_plain(p: Parameter) -> bool:
    return not (p.choices or p.directions or p.whole or p.log)
