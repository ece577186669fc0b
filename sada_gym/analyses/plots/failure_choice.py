"""Which failures a picture shows: the worst, typical ones, and ones that differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.evaluations import Evaluations
from sada_gym.parameters import ParameterSpace

ALIKE = 0.02
"""Two samples are alike where no parameter differs by more: a hundredth of its range."""

_MOST = 2_000
"""At most so many fooling samples, the first ones, are compared."""
_ROUNDS = 20

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ShownFailure:
    """A sample that fooled the agent, by its row, and how many others are hardly different.

    `stands_for` is the share of all fooling samples that a typical one is nearest to, else None.
    """

    sample: int
    alike: int
    stands_for: float | None = None


@dataclass(frozen=True)
class ShownFailures:
    """Three groups of failures, without a sample twice.

    The worst have the lowest Q, of equal ones the most typical; the typical are the medoids of the
    rest; the diverse lie farthest from all that are shown already.
    """

    worst: tuple[ShownFailure, ...]
    typical: tuple[ShownFailure, ...]
    diverse: tuple[ShownFailure, ...]

    @property
    def shown(self) -> tuple[ShownFailure, ...]:
        """All of them."""
        return self.worst + self.typical + self.diverse


def choose_failures(
    space: ParameterSpace, samples: Evaluations, threshold: float, counts: tuple[int, int, int]
) -> ShownFailures:
    """Choose samples that fool the agent, the same ones for the same samples.

    Of samples that are `ALIKE` only the one with the lowest Q may be shown. `counts` are the
    numbers of worst, typical and diverse failures; there are fewer where not as many differ.
    """
    rows = np.flatnonzero(samples.fooled(threshold))[:_MOST]
    if not len(rows):
        return ShownFailures((), (), ())
    places, score = features(space, samples.mu[rows]), samples.score[rows]
    apart = _distances(places)
    unlike, leader = _unlike(places, apart, np.lexsort((apart.mean(axis=1), score)))
    alike = np.bincount(leader, minlength=len(rows)) - 1
    worst = unlike[: counts[0]]
    typical, shares = _medoids(apart, unlike[counts[0] :], counts[1])
    others = np.setdiff1d(unlike[counts[0] :], typical)
    diverse = _farthest(apart, np.concatenate([worst, typical]), others, counts[2])
    share_of = dict(zip(typical.tolist(), shares.tolist(), strict=True))
    groups = (
        tuple(ShownFailure(int(rows[i]), int(alike[i]), share_of.get(i)) for i in group.tolist())
        for group in (worst, typical, diverse)
    )
    return ShownFailures(*groups)


def features(space: ParameterSpace, mu: npt.NDArray[np.float32]) -> Array:
    """Return places (n, k) whose distances say how different the worlds of mu (n, d) are.

    A parameter is its own place in [-1, 1]. One with choices has a column for each of them, so
    that any two choices are 1 apart, and places within a choice are the same.
    """
    columns = []
    for parameter, values in zip(space.parameters, mu.astype(np.float64).T, strict=True):
        count = len(parameter.choices)
        if count:
            choice = np.clip(((values + 1) / 2 * count).astype(int), 0, count - 1)
            columns.append(np.eye(count)[choice] / np.sqrt(2))
        else:
            columns.append(values[:, None])
    return np.concatenate(columns, axis=1)


def _distances(places: Array) -> Array:
    squares = (places**2).sum(axis=1)
    squared = squares[:, None] + squares - 2 * places @ places.T
    np.fill_diagonal(squared, 0.0)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _unlike(places: Array, apart: Array, order: Indices) -> tuple[Indices, Indices]:
    """Return the first of each group of samples that are alike, and for each sample its first."""
    leader = np.full(len(places), -1, np.intp)
    firsts = []
    for i in order:
        if leader[i] < 0:
            near = np.flatnonzero((leader < 0) & (apart[i] <= ALIKE * places.shape[1] ** 0.5))
            alike = np.abs(places[near] - places[i]).max(axis=1) <= ALIKE
            leader[near[alike]] = i
            firsts.append(i)
    return np.array(firsts, np.intp), leader


def _medoids(apart: Array, candidates: Indices, count: int) -> tuple[Indices, Array]:
    """Find candidates near which all samples lie, and the share of the samples nearest to each."""
    count = min(count, len(candidates))
    if not count:
        return np.empty(0, np.intp), np.empty(0)
    distance = apart[candidates]
    chosen: list[int] = []
    nearest = np.full(apart.shape[1], np.inf)
    for _ in range(count):  # each lessens the distances most
        sums = np.minimum(distance, nearest).sum(axis=1)
        sums[chosen] = np.inf
        chosen.append(int(sums.argmin()))
        nearest = np.minimum(nearest, distance[chosen[-1]])
    for _ in range(_ROUNDS):
        member = distance[chosen].argmin(axis=0)
        moved = list(chosen)
        for k in range(count):
            sums = distance[:, member == k].sum(axis=1)
            sums[[medoid for medoid in moved if medoid != moved[k]]] = np.inf
            moved[k] = int(sums.argmin()) if (member == k).any() else moved[k]
        if moved == chosen:
            break
        chosen = moved
    sizes = np.bincount(distance[chosen].argmin(axis=0), minlength=count)
    order = np.argsort(-sizes, kind="stable")
    return candidates[np.array(chosen)[order]], sizes[order] / apart.shape[1]


def _farthest(apart: Array, shown: Indices, candidates: Indices, count: int) -> Indices:
    chosen: list[int] = []
    nearest = apart[shown][:, candidates].min(axis=0, initial=np.inf)
    for _ in range(min(count, len(candidates))):
        best = int(nearest.argmax())
        chosen.append(int(candidates[best]))
        nearest = np.minimum(nearest, apart[candidates[best], candidates])
        nearest[best] = -1.0
    return np.array(chosen, np.intp)
