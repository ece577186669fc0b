"""The search track: what the training queries found, against how many were spent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats32, Indices, as_array
from sada_gym.foundations.files import Strict
from sada_gym.measures.coverage import (
    NEAREST,
    nearest_distances,
    neighbourhood_radii,
    validate_points,
)


class SearchPoint(Strict):
    """A point of an anytime curve, after so many queries.

    Attributes:
        found: The number of distinct mu among them that fooled. A repeated question finds nothing.
        share: The share of the queries that fooled.
        coverage: The share of the fooling set's points that have a found mu in their neighbourhood,
            see `sada_gym.measures.coverage.density_and_coverage`; None without a fooling set.
    """

    queries: int
    found: int
    share: float
    coverage: float | None


def anytime(
    queries: npt.ArrayLike,
    scores: npt.ArrayLike,
    threshold: float,
    fooling_set: npt.ArrayLike | None,
    checkpoints: Sequence[int],
    *,
    k: int = NEAREST,
) -> tuple[SearchPoint, ...]:
    """Measure what a search had found at each checkpoint.

    Coverage counts the points of the whole fooling set. It depends on the set's size R, so it
    compares searches on one set; `expected_coverage(R, found)` is what as many mu drawn from the
    truth would reach.

    Queries, (N, d), are in the order of asking and are rounded to float32; scores are (N,).
    Checkpoints are increasing numbers of queries, from 1 to N. The set is (R, d) with R > k, or
    None where no point is known to fool. Raise `UserError` for arguments that are not as described.
    """
    mu = as_array(queries, "queries").astype(np.float32)
    q = as_array(scores, "scores").astype(np.float64)
    if mu.ndim != 2 or q.shape != (len(mu),) or not np.isfinite(q).all():
        raise UserError(
            "Expected queries of shape (N, d) and finite scores of shape (N,), got "
            f"{mu.shape} and {q.shape}."
        )
    stops = list(checkpoints)
    if not stops or stops != sorted(set(stops)) or not 1 <= stops[0] <= stops[-1] <= len(mu):
        raise UserError(
            f"Expected increasing checkpoints from 1 to {len(mu)}, the number of queries, got "
            f"{stops}."
        )
    fooled = fools(q, threshold)
    rows = np.flatnonzero(fooled)
    firsts = np.sort(rows[np.unique(mu[rows], axis=0, return_index=True)[1]])
    counts = np.searchsorted(firsts, checkpoints)
    coverage: Sequence[float | None] = [None] * len(checkpoints)
    if fooling_set is not None:
        coverage = _coverage(mu[firsts], counts, fooling_set, k)
    spent = np.cumsum(fooled)
    return tuple(
        SearchPoint(queries=n, found=int(count), share=float(spent[n - 1] / n), coverage=covered)
        for n, count, covered in zip(checkpoints, counts, coverage, strict=True)
    )


def _coverage(found: Floats32, counts: Indices, fooling_set: npt.ArrayLike, k: int) -> list[float]:
    reference, fooling = validate_points(fooling_set, found, k)
    radii = neighbourhood_radii(reference, k)
    nearest = np.full(len(reference), np.inf)
    coverage, start = [], 0
    for stop in counts:
        nearest = np.minimum(nearest, nearest_distances(reference, fooling[start:stop]))
        coverage.append(float((nearest < radii).mean()))
        start = stop
    return coverage
