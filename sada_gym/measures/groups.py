"""Groups failures by how far they lie apart, and finds worlds like them that passed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sada_gym.foundations.arrays import Floats, Indices, Integers
from sada_gym.foundations.figures import number
from sada_gym.parameters import Mu, ParameterSpace

_NEAR = 0.5
"""Failures of a group are nearer than this share of the mean distance in the box."""

_MOST_CLUSTERED = 2_000
_REFERENCES = 19
"""Uniform worlds leave a larger gap than so many such sets before in one case of 20."""

_MOST_LINKED = 500
_LEAST_SHARE, _LEAST = 0.05, 3
"""What holds less of the failures is no group of its own."""

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


def distinct(
    mu: Mu, parameters: ParameterSpace, draw: Callable[[int], Mu] | None = None
) -> list[Indices]:
    """Group failures, (n, d), that gaps lie between; the largest group comes first.

    Uniform worlds have gaps, too, which are wide where there are few worlds or many parameters. So
    two groups lie apart where the gap between them is wider than any between as many uniform
    worlds, in 19 draws of these (single linkage). What is too small for a group joins the nearest.
    Each group's rows start in its middle; each further one is as far as can be from those before.

    Args:
        mu: At least one failure.
        parameters: Their space.
        draw: Draws so many uniform worlds of the region in which the failures lie; None stands for
            the whole space.
    """
    rng = np.random.default_rng(0)

    def anywhere(count: int) -> Mu:
        return rng.uniform(-1.0, 1.0, (count, len(parameters))).astype(np.float32)

    points = places(mu, parameters)
    linked = np.unique(np.linspace(0, len(mu) - 1, min(len(mu), _MOST_LINKED)).astype(np.intp))
    labels = _parts(points[linked], parameters, draw or anywhere)
    counts = np.bincount(labels)
    large = counts >= max(_LEAST, _LEAST_SHARE * len(linked))
    if large.sum() < 2:
        return [spread(points)]
    kept = large[labels]
    near = np.array([_nearest(points[linked[kept]], point) for point in points])
    labels = labels[kept][near]
    return _by_size(points, labels)


def _parts(points: Floats, parameters: ParameterSpace, draw: Callable[[int], Mu]) -> Integers:
    """Label points, (n, e), by the part that they lie in, (n,)."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(points) < _LEAST:
        return np.zeros(len(points), np.int64)
    drawn = (places(draw(len(points)), parameters) for _ in range(_REFERENCES))
    widest = max(linkage(uniform, "single")[:, 2].max() for uniform in drawn)
    labels: Integers = fcluster(linkage(points, "single"), widest, "distance") - 1
    return labels


def _nearest(points: Floats, point: Floats) -> int:
    return int(np.linalg.norm(points - point, axis=1).argmin())


def neighbourhoods(points: Floats, dimension: int) -> list[Indices]:
    """Group `places`, (n, e), of d parameters into small regions; the largest group comes first.

    By average linkage; with many parameters and few points there are many. Each group's rows start
    in its middle; each further one is as far as can be from those before.
    """
    from sklearn.cluster import AgglomerativeClustering

    count = len(points)
    if count > _MOST_CLUSTERED:
        kept = np.linspace(0, count - 1, _MOST_CLUSTERED).astype(np.intp)
        return [kept[rows] for rows in neighbourhoods(points[kept], dimension)]
    if count == 1:
        return [np.zeros(1, np.intp)]
    clustering = AgglomerativeClustering(
        n_clusters=None,
        linkage="average",
        distance_threshold=_NEAR * np.sqrt(2 * dimension / 3),  # of uniform points in the box
    )
    labels = clustering.fit_predict(points)
    return _by_size(points, labels)


def _by_size(points: Floats, labels: Integers) -> list[Indices]:
    groups = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    groups.sort(key=lambda rows: (-len(rows), rows[0]))
    return [rows[spread(points[rows])] for rows in groups]


def spread(points: Floats) -> Indices:
    """Order points, (n, e): the middle one, then each as far as can be from those before."""
    order = [_nearest(points, points.mean(axis=0))]
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
        matched[row] = int(rows[_nearest(candidates[rows], point)])
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
