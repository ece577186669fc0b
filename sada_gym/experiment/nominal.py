"""The world in ordinary use: how the agent does there, and which small changes make it fail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats, Floats32, Indices
from sada_gym.foundations.files import Strict
from sada_gym.parameters import Mu, ParameterSpace

SEEDS = 3
"""Evaluations of a world; the agent fails there if it fails in most of them."""

EPISODES, _CHEAP = 20, 0.05
"""The nominal world is played so often where that is at most this share of all evaluations."""

_SHARE = 0.25
"""With one evaluation a world where the search would cost more than this share of the budget."""

_STEPS = 5
"""Halvings of the way from the nominal value to a value that fails."""

COMBINED = 100
"""Worlds that show how often harmless amounts together do harm."""

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


class Combined(Strict):
    """How often the agent fails although each parameter alone would do no harm.

    Attributes:
        harmless: The values (low, high) of each parameter, all others nominal, between which the
            agent did not fail.
        worlds: The worlds that were drawn evenly within all these ranges; `fooled` fooled.
        failures: The test samples that fooled; of them `within` lie within all these ranges.
    """

    harmless: dict[str, tuple[float, float]]
    worlds: int
    fooled: int
    failures: int
    within: int


class NominalWorld(Strict):
    """The world in ordinary use, and what makes the agent fail there.

    Attributes:
        score: The mean of its `evaluations`, of which `fooled` fooled the agent.
        smallest: The parameters that make it fail alone, the smallest change first; none where the
            agent fails in the nominal world itself.
        nearest: None without any failure.
        combined: None where the application does not ask for it, or the agent fails in the nominal
            world itself.
        beside_budget: The evaluations that all this took; None in older files.
    """

    parameters: dict[str, float]
    score: float
    evaluations: int
    fooled: int
    smallest: tuple[SmallestChange, ...]
    nearest: NearestFailure | None
    combined: Combined | None = None
    beside_budget: int | None = None


def most_worlds(dimension: int) -> int:
    """Count the worlds that `explore_nominal` plays at most."""
    return 1 + 2 * dimension * (1 + _STEPS)


def seeds_within(budget: int, dimension: int) -> int:
    """Choose how often each world is evaluated in a run with so many training queries."""
    return SEEDS if SEEDS * most_worlds(dimension) <= _SHARE * budget else 1


def more_episodes(played: int, evaluations: int) -> int:
    """Count how often the nominal world is still played in a run of so many evaluations."""
    return max(0, EPISODES - played) if _CHEAP * evaluations >= EPISODES else 0


def how_often(record: Evaluations, threshold: float) -> dict[str, Any]:
    """Return the figures of a `NominalWorld` by its evaluations."""
    return {
        "score": float(record.valid.score.mean()) if len(record.valid) else 0.0,
        "evaluations": len(record),
        "fooled": int(record.fooled(threshold).sum()),
    }


def explore_nominal(
    space: ParameterSpace,
    nominal: Floats32,
    play: Play,
    known: Evaluations,
    threshold: float,
    *,
    samples: Evaluations | None = None,
    combine: np.random.Generator | None = None,
) -> NominalWorld:
    """Play the nominal world, (d,), and look for the smallest change of each parameter that fails.

    Both ends of each range are tried, and where one fails, the way there is halved a few times:
    `most_worlds(d)` at most. `known` are evaluations whose failures count as known. With test
    samples and a generator, `COMBINED` worlds more are played whose parameters are all harmless.
    """
    record = play(nominal[None])
    smallest: list[SmallestChange] = []
    combined = None
    if not _fails(record, 1, threshold)[0]:
        smallest, harmless = _smallest_changes(space, nominal, play, threshold)
        if combine is not None and samples is not None:
            combined = _combined(space, harmless, play, samples, threshold, combine)
    return NominalWorld(
        parameters=space.describe(nominal),
        **how_often(record, threshold),
        smallest=tuple(smallest),
        nearest=_nearest(space, nominal, known.mu[known.fooled(threshold)]),
        combined=combined,
    )


def _smallest_changes(
    space: ParameterSpace, nominal: Floats32, play: Play, threshold: float
) -> tuple[list[SmallestChange], Floats]:
    """Return the changes, and the ends of what is harmless of each parameter alone, (d, 2)."""
    d = len(space)
    axes = np.tile(np.arange(d), 2)
    ends = _centred(space, axes, np.repeat([-1.0, 1.0], d))
    usual_place = _centred(space, axes, nominal[axes].astype(np.float64))
    away = ends != usual_place
    axes, ends, usual_place = axes[away], ends[away], usual_place[away]
    fails = _fails(play(_moved(nominal, axes, ends)), len(axes), threshold)
    harmless = np.repeat(nominal.astype(np.float64)[:, None], 2, axis=1)
    harmless[axes[~fails], (ends[~fails] > 0).astype(int)] = ends[~fails]
    axes, failing, holding = axes[fails], ends[fails], usual_place[fails]
    for _ in range(_STEPS if len(axes) else 0):
        middle = _centred(space, axes, (holding + failing) / 2.0)
        between = (middle != holding) & (middle != failing)
        if not between.any():
            break
        fails = _fails(play(_moved(nominal, axes, middle)), len(axes), threshold)
        holding = np.where(between & ~fails, middle, holding)
        failing = np.where(between & fails, middle, failing)
    harmless[axes, (failing > holding).astype(int)] = holding
    order = np.argsort(np.abs(failing - nominal[axes]), kind="stable")
    usual = space.physical(nominal[None])[0]
    moved = space.physical(_moved(nominal, axes, failing))
    changes = [
        SmallestChange(
            parameter=space.names[axes[k]],
            nominal=float(usual[axes[k]]),
            value=float(moved[k, axes[k]]),
        )
        for k in order
    ]
    return changes, harmless


def _centred(space: ParameterSpace, axes: Indices, mu: Floats) -> Floats:
    """Move the mu of whole numbers and choices, (n,), to the middle of what is the same world."""
    centred = mu.copy()
    for k, axis in enumerate(axes):
        if count := space.parameters[axis].count:
            cell = min(int((mu[k] + 1.0) / 2.0 * count), count - 1)
            centred[k] = (2.0 * cell + 1.0) / count - 1.0
    return centred


def _combined(
    space: ParameterSpace,
    harmless: Floats,
    play: Play,
    samples: Evaluations,
    threshold: float,
    rng: np.random.Generator,
) -> Combined:
    low, high = harmless.astype(np.float32).T
    drawn = play(rng.uniform(low, high, (COMBINED, len(space))).astype(np.float32).clip(low, high))
    failures = samples.mu[samples.fooled(threshold)]
    within = ((failures >= low) & (failures <= high)).all(axis=1)
    ends = space.physical(np.stack([low, high]))
    return Combined(
        harmless={
            name: (float(a), float(b)) for name, (a, b) in zip(space.names, ends.T, strict=True)
        },
        worlds=COMBINED,
        fooled=int(_fails(drawn, COMBINED, threshold).sum()),
        failures=len(failures),
        within=int(within.sum()),
    )


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
