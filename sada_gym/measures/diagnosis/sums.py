"""Finds pairs of parameters that matter together: failures lie along a slanted band."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.measures.diagnosis.axes import Axis
from sada_gym.measures.diagnosis.search import SUM_COST, Value, best_cells
from sada_gym.parameters import Parameter, ParameterSpace

SLOPES = (-2.0, -1.4, -1.0, -0.7, -0.5, 0.5, 0.7, 1.0, 1.4, 2.0)
_MOST_SUMS = 4
_MOST_PARAMETERS = 24
"""Of more parameters there are too many pairs."""


def sums(space: ParameterSpace, physical: Floats, fooled: Bools, elsewhere: float) -> list[Axis]:
    """Return axes of sums of two parameters along which failures crowd more than along either."""
    none = np.zeros_like(fooled)

    def gains(axes: Sequence[Axis]) -> Floats:
        return best_alone(axes, physical, fooled, none, elsewhere)[1]

    found: list[tuple[float, Axis]] = []
    single = [
        float(gains([Axis.of(p, i)])[0]) if _is_plain(p) else 0.0
        for i, p in enumerate(space.parameters)
    ]
    for i, j in pairs(space):
        axes = [Axis.sum(space, i, j, slope) for slope in SLOPES]
        gain = gains(axes)
        lead = float(gain.max()) - max(single[i], single[j])
        if lead > SUM_COST:
            found.append((lead, axes[int(gain.argmax())]))
    found.sort(key=lambda pair: -pair[0])
    return [axis for _, axis in found[:_MOST_SUMS]]


def pairs(space: ParameterSpace) -> list[tuple[int, int]]:
    """Return the places of parameters that make a sum: metres and degrees make none."""
    if len(space) > _MOST_PARAMETERS:
        return []
    plain = [i for i, p in enumerate(space.parameters) if _is_plain(p)]
    units = [p.unit for p in space.parameters]
    return [(i, j) for i, j in combinations(plain, 2) if units[i] == units[j]]


def best_alone(
    axes: Sequence[Axis], physical: Floats, fooled: Bools, covered: Bools, elsewhere: float
) -> tuple[Bools, Floats]:
    """Return the best interval of each axis with no other condition, and its value.

    Args:
        axes: k axes of g cells each.
        physical: The worlds' physical values, (n, d).
        fooled: Which worlds fooled, (n,).
        covered: Which worlds a box explains already, (n,).
        elsewhere: The fooling rate elsewhere.

    Returns:
        The cells, (k, g), and the values, (k,).
    """
    g, kinds = len(axes[0]), np.where(covered, 2, fooled)
    cells = [3 * axis.cells(physical) + kinds for axis in axes]
    counts = np.stack([np.bincount(own, minlength=3 * g).reshape(g, 3).T for own in cells])
    counts[:, 0] += counts[:, 1]
    return best_cells(axes[0], counts.astype(np.float64), Value(elsewhere))


def _is_plain(p: Parameter) -> bool:
    return not (p.choices or p.directions or p.whole or p.log)
