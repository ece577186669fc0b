"""Groups failures into distinct ones, and finds a world like each in which the agent passed."""

from __future__ import annotations

import numpy as np

from sada_gym.arrays import Floats, Indices
from sada_gym.parameters import Mu, ParameterSpace, number

_NEAR = 0.5
"""Failures of a group are nearer than this share of the mean distance in the box."""

_MOST_CLUSTERED = 2_000
_NARROW = 0.5
_FEWEST, _MOST_WORDS = 3, 3


def places(mu: Mu, parameters: ParameterSpace) -> Floats:
    """Return points, (n, e), whose distances are those of mu, (n, d), around full angles too."""
    columns = []
    for column, parameter in zip(mu.T.astype(np.float64), parameters.parameters, strict=True):
        if parameter.directions:  # around a circle, where uniform points are as far apart
            columns += [np.cos(np.pi * column) / np.sqrt(3), np.sin(np.pi * column) / np.sqrt(3)]
        else:
            columns.append(column)
    return np.stack(columns, axis=1)


def distinct(points: Floats, dimension: int) -> list[Indices]:
    """Group `places`, (n, e), of d parameters by average linkage; the largest group comes first.

    Each group's rows start in its middle; each further one is as far as can be from those before.
    """
    from sklearn.cluster import AgglomerativeClustering

    count = len(points)
    if count > _MOST_CLUSTERED:
        kept = np.linspace(0, count - 1, _MOST_CLUSTERED).astype(np.intp)
        return [kept[rows] for rows in distinct(points[kept], dimension)]
    if count == 1:
        return [np.zeros(1, np.intp)]
    clustering = AgglomerativeClustering(
        n_clusters=None,
        linkage="average",
        distance_threshold=_NEAR * np.sqrt(2 * dimension / 3),  # of uniform points in the box
    )
    labels = clustering.fit_predict(points)
    groups = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    groups.sort(key=lambda rows: (-len(rows), rows[0]))
    return [rows[_spread(points[rows])] for rows in groups]


def _spread(points: Floats) -> Indices:
    order = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())]
    nearest = np.full(len(points), np.inf)
    while len(order) < len(points):
        nearest = np.minimum(nearest, np.linalg.norm(points - points[order[-1]], axis=1))
        nearest[order] = -1.0
        order.append(int(nearest.argmax()))
    return np.array(order, np.intp)


def match(points: Floats, candidates: Floats, free: set[int]) -> dict[int, int]:
    """Find the nearest free candidate of each point, one after another, and take it.

    Returns:
        The candidates by the points' rows; a point has none where no candidate is left.
    """
    matched = {}
    for row, point in enumerate(points):
        if not free:
            break
        rows = np.array(sorted(free), np.intp)
        matched[row] = int(rows[np.linalg.norm(candidates[rows] - point, axis=1).argmin()])
        free.remove(matched[row])
    return matched


def words(mu: Mu, parameters: ParameterSpace) -> str:
    """Say where the worlds of a group, (n, d), lie: at most three ranges, in units.

    They are those that are narrowest, and narrower than half of what n uniform points span.
    """
    if len(mu) < _FEWEST:
        return "too few worlds to say where"
    expected = 2 * (len(mu) - 1) / (len(mu) + 1)
    widths = np.ptp(mu, axis=0)
    narrowest = np.argsort(widths, kind="stable")[:_MOST_WORDS]
    physical = parameters.physical(mu)
    parts = []
    for i in sorted(narrowest[widths[narrowest] <= _NARROW * expected].tolist()):
        parameter = parameters.parameters[i]
        low, high = float(physical[:, i].min()), float(physical[:, i].max())
        ends = [parameter.text(low), parameter.text(high)]
        if ends[0] == ends[1]:
            parts.append(ends[0])
        elif parameter.choices:
            parts.append(f"{ends[0]} to {ends[1].removeprefix(parameter.label).strip()}")
        else:
            parts.append(f"{parameter.label} {number(low)} to {parameter.with_unit(number(high))}")
    return ", ".join(parts) or "nowhere in particular"
