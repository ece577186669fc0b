"""Groups failures by the weakness that they lie in, and by gaps within it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.foundations.arrays import Indices
from sada_gym.measures.diagnosis.record import Condition, Diagnosis, Weakness
from sada_gym.measures.diagnosis.rules import draw, holds
from sada_gym.measures.failures import Group
from sada_gym.measures.groups import distinct, words
from sada_gym.parameters import Mu, ParameterSpace

NO_WEAKNESS = "outside all weaknesses"
_ALL = slice(None)


def grouped(diagnosis: Diagnosis, space: ParameterSpace, mu: Mu) -> list[Group]:
    """Group failures, (n, d): each belongs to the first weakness whose rule holds.

    The failures of one weakness are several groups where wide gaps lie between them. Those outside
    all weaknesses are one group; without any weakness, gaps alone make the groups.
    """
    groups: list[Group] = []
    for group in by_weakness(diagnosis.weaknesses, space, mu):
        conditions = diagnosis.weaknesses[group.weakness - 1].conditions if group.weakness else ()
        parts = parts_of(conditions, space, mu[group.rows]) if conditions else [_ALL]
        for part in parts:
            rows = group.rows[part]
            where = group.where if len(parts) == 1 else words(mu[rows], space)
            groups.append(Group(rows, where, group.weakness))
    return groups


def by_weakness(weaknesses: Sequence[Weakness], space: ParameterSpace, mu: Mu) -> list[Group]:
    """Group failures, (n, d), as `grouped` does, but each weakness makes one group."""
    if not weaknesses:
        return [Group(rows, words(mu[rows], space), 0) for rows in distinct(mu, space)]
    left, groups = np.ones(len(mu), np.bool_), []
    for number, weakness in enumerate(weaknesses, 1):
        rows = np.flatnonzero(left & holds(weakness.conditions, space, mu))
        left[rows] = False
        groups.append(Group(rows, weakness.text, number))
    groups.append(Group(np.flatnonzero(left), NO_WEAKNESS, 0))
    return [group for group in groups if len(group.rows)]


def parts_of(conditions: Sequence[Condition], space: ParameterSpace, mu: Mu) -> list[Indices]:
    """Group failures, (n, d), in which conditions hold, by wide gaps, see `distinct`."""
    rng = np.random.default_rng(0)
    return distinct(mu, space, lambda count: draw(conditions, space, count, rng))
