"""The world in ordinary use: how the agent does there, and which small changes make it fail."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats, Floats32
from sada_gym.foundations.files import Strict
from sada_gym.parameters import Mu, ParameterSpace

SEEDS = 3
"""Evaluations of a world; the agent fails there if it fails in most of them."""

_SHARE = 0.25
"""With one evaluation a world where the search would cost more than this share of the budget."""

_STEPS = 5
"""Halvings of the way from the nominal value to a value that fails."""

Play = Callable[[Mu], Evaluations]
"""Evaluates each world equally often, in a row."""


class SmallestChange(Strict):
    """The value of one parameter, all others nominal, from which on the agent fails.

    Nothing is said of what lies beyond it. The nominal value is `nominal`.
    """

    parameter: str
    nominal: float
    value: float


class NearestFailure(Strict):
    """The known failure nearest to the nominal world, by the greatest change of a parameter.

    Attributes:
        change: That change, as a share of the parameter's range.
    """

    parameters: dict[str, float]
    change: float


class NominalWorld(Strict):
    """The world in ordinary use, and what makes the agent fail there.

    Attributes:
        score: The mean of its `evaluations`, of which `fooled` fooled the agent.
        smallest: The parameters that make it fail alone, the smallest change first; none where the
            agent fails in the nominal world itself.
        nearest: None without any failure.
    """

    parameters: dict[str, float]
    score: float
    evaluations: int
    fooled: int
    smallest: tuple[SmallestChange, ...]
    nearest: NearestFailure | None


def most_worlds(dimension: int) -> int:
    """Count the worlds that `explore_nominal` plays at most."""
    return 1 + 2 * dimension * (1 + _STEPS)


def seeds_within(budget: int, dimension: int) -> int:
    """Choose how often each world is evaluated in a run with so many training queries."""
    return SEEDS if SEEDS * most_worlds(dimension) <= _SHARE * budget else 1


def explore_nominal(
    space: ParameterSpace, nominal: Floats32, play: Play, known: Evaluations, threshold: float
) -> NominalWorld:
    """Play the nominal world, (d,), and look for the smallest change of each parameter that fails.

    Both ends of each range are tried, and where one fails, the way there is halved a few times:
    `most_worlds(d)` at most. `known` are evaluations whose failures count as known.
    """
    record = play(nominal[None])
    smallest: list[SmallestChange] = []
    if not _fails(record, 1, threshold)[0]:
        smallest = _smallest_changes(space, nominal, play, threshold)
    return NominalWorld(
        parameters=space.describe(nominal),
        score=float(record.valid.score.mean()) if len(record.valid) else 0.0,
        evaluations=len(record),
        fooled=int(record.fooled(threshold).sum()),
        smallest=tuple(smallest),
        nearest=_nearest(space, nominal, known.mu[known.fooled(threshold)]),
    )


def _smallest_changes(
    space: ParameterSpace, nominal: Floats32, play: Play, threshold: float
) -> list[SmallestChange]:
    d = len(space)
    axes, ends = np.tile(np.arange(d), 2), np.repeat([-1.0, 1.0], d)
    away = np.abs(ends - nominal[axes]) > 0
    axes, ends = axes[away], ends[away]
    fails = _fails(play(_moved(nominal, axes, ends)), len(axes), threshold)
    axes, failing = axes[fails], ends[fails]
    holding = nominal[axes].astype(np.float64)
    for _ in range(_STEPS if len(axes) else 0):
        middle = (holding + failing) / 2.0
        fails = _fails(play(_moved(nominal, axes, middle)), len(axes), threshold)
        holding, failing = np.where(fails, holding, middle), np.where(fails, middle, failing)
    order = np.argsort(np.abs(failing - nominal[axes]), kind="stable")
    usual = space.physical(nominal[None])[0]
    moved = space.physical(_moved(nominal, axes, failing))
    return [
        SmallestChange(
            parameter=space.names[axes[k]],
            nominal=float(usual[axes[k]]),
            value=float(moved[k, axes[k]]),
        )
        for k in order
    ]


def _moved(nominal: Floats32, axes: np.ndarray, values: Floats) -> Mu:
    mu = np.repeat(nominal[None], len(axes), axis=0)
    mu[np.arange(len(axes)), axes] = values
    return mu


def _fails(record: Evaluations, count: int, threshold: float) -> Bools:
    """Say in which of so many worlds the agent fails, (count,)."""
    fails: Bools = record.fooled(threshold).reshape(count, -1).mean(axis=1) > 0.5
    return fails


def _nearest(space: ParameterSpace, nominal: Floats32, failures: Mu) -> NearestFailure | None:
    if not len(failures):
        return None
    change = np.abs(failures - nominal).max(axis=1) / 2.0
    i = int(change.argmin())
    return NearestFailure(parameters=space.describe(failures[i]), change=float(change[i]))
