"""Groups failures by the weakness that they lie in, and by gaps within it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.arrays import Indices
from sada_gym.diagnosis.record import Diagnosis
from sada_gym.diagnosis.rules import draw, holds
from sada_gym.failures import Group
from sada_gym.measures.failure_regions import Condition
from sada_gym.measures.groups import distinct, words
from sada_gym.parameters import Mu, ParameterSpace

NO_WEAKNESS = "in no weakness"


def grouped(diagnosis: Diagnosis, space: ParameterSpace, mu: Mu) -> list[Group]:
    """Group failures, (n, d): each belongs to the first weakness whose rule holds.

    The failures of one weakness are several groups where wide gaps lie between them. Those in no
    weakness are one group; where there is no weakness at all, gaps alone make the groups.
    """
    left, groups = np.ones(len(mu), np.bool_), []
    for number, weakness in enumerate(diagnosis.weaknesses, 1):
        rows = np.flatnonzero(left & holds(weakness.conditions, space, mu))
        left[rows] = False
        parts = parts_of(weakness.conditions, space, mu[rows]) if len(rows) else []
        for part in parts:
            where = weakness.text if len(parts) == 1 else words(mu[rows[part]], space)
            groups.append(Group(rows[part], where, number))
    rest = np.flatnonzero(left)
    if not diagnosis.weaknesses:
        groups = [Group(rows, words(mu[rows], space), 0) for rows in distinct(mu, space)]
    elif len(rest):
        groups.append(Group(rest, NO_WEAKNESS, 0))
    return groups


def parts_of(conditions: Sequence[Condition], space: ParameterSpace, mu: Mu) -> list[Indices]:
    """Group failures, (n, d), in which conditions hold, by wide gaps, see `distinct`."""
    rng = np.random.default_rng(0)
    return distinct(mu, space, lambda count: draw(conditions, space, count, rng))
