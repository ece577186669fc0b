"""How much of the true fooling set the samples cover: density and coverage."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats, Indices, as_array

NEAREST = 5
"""The number k of the neighbour that sets the radius around a reference point."""

DRAWS = 20
"""The number of times that the reference points are drawn anew."""

_BLOCK = 2**22  # distances held at once: 32 MiB


@dataclass(frozen=True)
class DensityCoverage:
    """How samples lie among reference points.

    The density is the mean number of reference points' neighbourhoods that a sample lies in, over
    k: about 1 where both have one distribution, above 1 where samples crowd dense places. The
    coverage is the share of the reference points with a sample in their neighbourhood.
    """

    density: float
    coverage: float


@dataclass(frozen=True)
class FoolingCoverage(DensityCoverage):
    """How the samples that fool lie in the fooling set: means over draws of so many points each."""

    points: int
    draws: int


def density_and_coverage(
    real: npt.ArrayLike, fake: npt.ArrayLike, k: int = NEAREST
) -> DensityCoverage:
    """Measure density and coverage (Naeem et al., ICML 2020, section 3.2).

    The neighbourhood of a real point is the open ball that reaches to its k-th nearest other real
    point. Where more than k real points coincide it is empty: they are never covered.

    The reference points are (n, d) with n > k, the samples (m, d); no samples give zeros.

    Raises:
        ValueError: If the shapes do not fit, or there are too few reference points.
    """
    reference, samples = validate_points(real, fake, k)
    radii = neighbourhood_radii(reference, k)
    inside = covered = 0
    for rows, distances in _distances(reference, samples):
        hits = distances < radii[rows, None]
        inside += int(hits.sum())
        covered += int(hits.any(axis=1).sum())
    return DensityCoverage(inside / (k * max(len(samples), 1)), covered / len(reference))


def fooling_coverage(
    samples: npt.ArrayLike,
    fooled: npt.ArrayLike,
    fooling_set: npt.ArrayLike,
    *,
    seed: int = 0,
    draws: int = DRAWS,
    k: int = NEAREST,
) -> FoolingCoverage:
    """Measure how much of the fooling set an adversary's samples cover.

    In each draw as many points of the fooling set as there are samples, without replacement,
    stand against those samples that fool. The draws depend on the seed and on both sizes alone, so
    adversaries with equally many samples are compared on the same points. A fooling set of fewer
    than M points is taken whole: its coverage is then higher by nature, and comparable when divided
    by that of ideal samples.

    `fooled`, (M,) bool, says which test samples, (M, d), fooled the agent. The points known to
    fool, (R, d) with R > k, are uniform in the true fooling set.

    Raises:
        ValueError: If the shapes do not fit, there are no samples, or too few points.
    """
    reference, mu = validate_points(fooling_set, samples, k)
    mask = as_array(fooled, "fooled")
    if mask.shape != (len(mu),) or mask.dtype != np.bool_ or not len(mu):
        raise UserError(
            f"Expected fooled of shape ({len(mu)},) with bools, one for each of at least one "
            f"sample, got shape {mask.shape} of {mask.dtype}."
        )
    chosen = reference_draws(len(reference), len(mu), draws=draws, seed=seed)
    measured = [density_and_coverage(reference[rows], mu[mask], k) for rows in chosen]
    return FoolingCoverage(
        density=float(np.mean([draw.density for draw in measured])),
        coverage=float(np.mean([draw.coverage for draw in measured])),
        points=chosen.shape[1],
        draws=draws,
    )


def expected_coverage(real: int, fake: int, k: int = NEAREST) -> float:
    """Return the mean coverage of samples that come from the reference points' own distribution.

    1 - (n-1)...(n-k) / ((m+n-1)...(m+n-k)) for n real and m fake points, whatever the distribution,
    as long as it has no ties (Naeem et al. 2020, lemma 2): a point is uncovered where its k nearest
    among all others are all real. n must be above k.
    """
    _check_k(real, k)
    if fake < 0:
        raise UserError(f"Expected at least 0 samples, got {fake}.")
    return 1.0 - math.prod((real - i) / (real + fake - i) for i in range(1, k + 1))


def relative_coverage(coverage: float, ideal: float) -> float:
    """Return coverage in units of that of ideal samples: 1 is as good as the truth itself.

    The ideal coverage is that of M samples of the true fooling set: by `fooling_coverage`, or
    `expected_coverage` where all of them fool. It must be within (0, 1], else ValueError.
    """
    if not 0.0 < ideal <= 1.0:
        raise UserError(f"Expected an ideal coverage within (0, 1], got {ideal}.")
    return coverage / ideal


def reference_draws(available: int, wanted: int, *, draws: int, seed: int) -> Indices:
    """Draw rows of a fooling set without replacement: (draws, min(wanted, available))."""
    if draws < 1:
        raise UserError(f"Expected at least 1 draw, got {draws}.")
    rng, size = np.random.default_rng(seed), min(wanted, available)
    return np.array([rng.choice(available, size, replace=False) for _ in range(draws)], np.intp)


def neighbourhood_radii(points: Floats, k: int) -> Floats:
    """Measure each point's distance to its k-th nearest other point: (n,)."""
    # the point itself is the nearest, at distance 0
    return np.concatenate(
        [np.partition(part, k, axis=1)[:, k] for _, part in _distances(points, points)]
    )


def nearest_distances(points: Floats, others: Floats) -> Floats:
    """Measure each point's distance to the nearest of others: (n,), infinite without any."""
    parts = [part.min(axis=1, initial=np.inf) for _, part in _distances(points, others)]
    return np.concatenate(parts)


def validate_points(real: npt.ArrayLike, fake: npt.ArrayLike, k: int) -> tuple[Floats, Floats]:
    """Return reference points (n, d), n > k, and samples (m, d) as float64; else ValueError."""
    reference = as_array(real, "real").astype(np.float64)
    samples = as_array(fake, "fake").astype(np.float64)
    if reference.ndim != 2 or samples.ndim != 2 or reference.shape[1] != samples.shape[1]:
        raise UserError(
            "Expected reference points of shape (n, d) and samples of shape (m, d), got "
            f"{reference.shape} and {samples.shape}."
        )
    if not (np.isfinite(reference).all() and np.isfinite(samples).all()):
        raise UserError("Expected finite points, got NaN or infinite values among them.")
    _check_k(len(reference), k)
    return reference, samples


def _distances(points: Floats, others: Floats) -> Iterator[tuple[slice, Floats]]:
    """Measure how far points (n, d) lie from others (m, d), block by block of (rows, m)."""
    from scipy.spatial.distance import cdist  # `sada_gym.attack` stays light

    size = max(1, _BLOCK // max(len(others), 1))
    for start in range(0, len(points), size):
        rows = slice(start, start + size)
        yield rows, cdist(points[rows], others)


def _check_k(points: int, k: int) -> None:
    if not 1 <= k < points:
        raise UserError(
            f"Expected at least k + 1 = {k + 1} reference points with k >= 1, got {points}. "
            "Take a larger reference set, or a smaller k."
        )
