"""Finds rules for where worlds fool the agent, among known worlds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sada_gym.foundations.arrays import Bools
from sada_gym.measures.diagnosis.axes import Axis
from sada_gym.measures.diagnosis.bands import banded
from sada_gym.measures.diagnosis.search import (
    RULE_COST,
    BoxSearch,
    KnownWorlds,
    cover,
    grow,
    prune,
    rate_elsewhere,
)
from sada_gym.measures.diagnosis.sums import sums
from sada_gym.measures.diagnosis.thresholds import Rule, holds, recut, refine
from sada_gym.parameters import Mu, ParameterSpace

_LEAST_GAIN = 8.0
_MOST = 7
"""Of so many rules fresh worlds choose."""


@dataclass(frozen=True, eq=False)
class Found:
    """Rules, the strongest first, and what the known worlds say.

    Attributes:
        gains: How much more likely each rule makes the worlds, as a logarithm, less its costs.
        rates: The fooling rate in each, within (0, 1).
        elsewhere: The fooling rate outside all, within (0, 1).
    """

    rules: tuple[Rule, ...]
    gains: tuple[float, ...]
    rates: tuple[float, ...]
    elsewhere: float


def find_rules(space: ParameterSpace, mu: Mu, fooled: Bools, uniform: Bools, seed: int) -> Found:
    """Find rules by worlds, (n, d), whether each fooled, (n,), and whether it was drawn evenly."""
    if not fooled.any():
        return Found((), (), (), 0.5)
    physical, rng = space.physical(mu), np.random.default_rng(seed)
    axes = [Axis.of(parameter, j) for j, parameter in enumerate(space.parameters)]
    outset = rate_elsewhere(KnownWorlds(np.zeros((1, len(mu)), np.intp), fooled), uniform, [])
    axes += sums(space, physical, fooled, outset)
    search = BoxSearch(axes, _worlds(axes, space, mu, fooled), rng)
    boxes = cover(search, uniform, _MOST, _LEAST_GAIN)
    search, boxes = banded(space, physical, search, uniform, boxes)
    axes, elsewhere = list(search.axes), rate_elsewhere(search.worlds, uniform, boxes)
    # once more in cells that end where the rules do: no slivers are left beside them
    rules = refine(axes, boxes, physical, fooled, elsewhere, rounded=False)
    axes, boxes = recut(axes, rules, [box.gain for box in boxes])
    search = BoxSearch(axes, _worlds(axes, space, mu, fooled), rng)
    boxes = prune(search, uniform, [box for box in boxes if box.conditions])
    boxes = prune(search, uniform, grow(search, uniform, boxes, _MOST, _LEAST_GAIN))
    boxes.sort(key=lambda box: -box.gain)
    elsewhere = rate_elsewhere(search.worlds, uniform, boxes)
    rules = refine(axes, boxes, physical, fooled, elsewhere, rounded=True)
    kept = [i for i, rule in enumerate(rules) if rule]
    rules, gains = [rules[i] for i in kept], tuple(boxes[i].gain - RULE_COST for i in kept)
    inside = [holds(rule, physical) for rule in rules]
    rates = tuple((fooled[rows].sum() + 0.5) / (rows.sum() + 1.0) for rows in inside)
    return Found(tuple(rules), gains, tuple(map(float, rates)), elsewhere)


def _worlds(axes: list[Axis], space: ParameterSpace, mu: Mu, fooled: Bools) -> KnownWorlds:
    physical = space.physical(mu)
    return KnownWorlds(np.stack([axis.cells(physical) for axis in axes]), fooled)
