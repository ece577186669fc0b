"""The measures of a run: those of the adversary's test samples, and those of its search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.evaluations import Evaluations
from sada_gym.foundations.files import Strict
from sada_gym.measures.coverage import NEAREST, fooling_coverage, relative_coverage
from sada_gym.measures.novelty import Neighbour, Neighbours, Novelty, novelty, relative_novelty
from sada_gym.measures.rates import attack_fooling_rate, mu_std, nearest_neighbours
from sada_gym.measures.search import SearchPoint, anytime
from sada_gym.parameters import Mu


class Distances(Strict):
    """The distances from the test samples to the nearest of some queries."""

    minimum: float
    median: float
    mean: float
    maximum: float


class FeasibleRate(Strict):
    """The AFR over test samples whose worlds a privileged agent passes; None if it passes none."""

    worlds: int
    fooled: int
    afr: float | None


class ImageNovelty(Strict):
    """How far the images of a few samples are from those of queries (root mean square of pixels).

    Attributes:
        median: The median distance to the nearest image among the queries that were compared.
        median_of_nearest_mu: The median distance to the image of the query that is nearest in mu.
        ideal: The same as `median` for as many ideal samples; None without a reference set.
    """

    samples: int
    median: float
    median_of_nearest_mu: float
    ideal: float | None

    @property
    def ratio(self) -> float | None:
        """The median divided by that of ideal samples."""
        return self.median / self.ideal if self.ideal else None


class Measures(Strict):
    """The measures of the test samples.

    Attributes:
        afr: The attack fooling rate, over the samples whose world is valid.
        afr_interval_95: Its Wilson interval.
        fooled: How many of these samples fooled.
        mean_score: Their mean Q.
        mu_std: The spread of all samples; 0.577 for uniform samples.
        density: About 1 if the samples that fool are spread like the fooling set. Without a
            reference set, or with too few samples, this and the next two are None.
        coverage: The share of the fooling set that is covered by the samples that fool.
        relative_coverage: The coverage divided by that of ideal samples of the same seed.
        novelty: How far the samples are from the training queries; None without queries.
        image_novelty: How far their images are from those of queries; None if none were compared.
        feasible: The AFR over feasible worlds; None without a privileged agent.
    """

    afr: float
    afr_interval_95: tuple[float, float]
    fooled: int
    mean_score: float
    mu_std: float
    density: float | None
    coverage: float | None
    relative_coverage: float | None
    novelty: Novelty | None
    image_novelty: ImageNovelty | None
    feasible: FeasibleRate | None = None


class Search(Strict):
    """What the training queries found.

    Attributes:
        curve: What was found after 100, 200, 500, 1,000 and so on queries, and after the last one.
    """

    queries: int
    fooled: int
    curve: tuple[SearchPoint, ...]

    @property
    def fooling_rate(self) -> float | None:
        """The share of queries that fooled; None without queries."""
        return self.fooled / self.queries if self.queries else None


def measure(
    samples: Evaluations,
    queries: Evaluations,
    threshold: float,
    *,
    fooling_set: Mu | None,
    ideal: Evaluations | None,
    images: ImageNovelty | None,
    seed: int,
    feasible: FeasibleRate | None = None,
) -> Measures:
    """Measure an adversary's M test samples, with the fooling threshold epsilon.

    Args:
        samples: The test samples.
        queries: The training queries.
        threshold: Epsilon.
        fooling_set: (R, d) points known to fool; None where none are known.
        ideal: M ideal samples, evaluated on the same seeds; None without a fooling set.
        images: The result of comparing images; None where none were compared.
        seed: Fixes the draws of reference points.
        feasible: The rate over feasible worlds; None where no privileged agent is known.
    """
    valid = samples.valid
    rate = attack_fooling_rate(valid.score, threshold)
    density = coverage = relative = None
    if fooling_set is not None and ideal is not None and len(samples) > NEAREST:
        ours, truth = (
            fooling_coverage(pool.mu, pool.fooled(threshold), fooling_set, seed=seed)
            for pool in (samples, ideal)
        )
        density, coverage = ours.density, ours.coverage
        relative = relative_coverage(coverage, truth.coverage) if truth.coverage else None
    distances: Novelty | None = None
    if len(queries) and ideal is None:
        distances = novelty(samples.mu, queries.mu)
    elif len(queries) and ideal is not None:
        distances = relative_novelty(samples.mu, ideal.mu, queries.mu)
    return Measures(
        afr=rate.rate,
        afr_interval_95=(rate.low, rate.high),
        fooled=rate.fooled,
        mean_score=float(valid.score.mean()),
        mu_std=mu_std(samples.mu),
        density=density,
        coverage=coverage,
        relative_coverage=relative,
        novelty=distances,
        image_novelty=images,
        feasible=feasible,
    )


def follow_search(queries: Evaluations, threshold: float, *, fooling_set: Mu | None) -> Search:
    """Measure what the training queries found, in the order of asking; `fooling_set` is (R, d)."""
    at = checkpoints(len(queries))
    return Search(
        queries=len(queries),
        fooled=int(queries.fooled(threshold).sum()),
        curve=anytime(queries.mu, queries.score, threshold, fooling_set, at) if at else (),
    )


def checkpoints(queries: int) -> list[int]:
    """Numbers of queries at which a search is measured: 100, 200, 500, ... and the last."""
    usual = [step * 10**power for power in range(2, 10) for step in (1, 2, 5)]
    return [*(count for count in usual if count < queries), *([queries] if queries else [])]


def feasible_rate(
    fooled: npt.NDArray[np.bool_], feasible: npt.NDArray[np.bool_] | None
) -> FeasibleRate | None:
    """Sum up `Application.feasible`, (M,) as `fooled`; None where no privileged agent is known."""
    if feasible is None:
        return None
    worlds, both = int(feasible.sum()), int((fooled & feasible).sum())
    return FeasibleRate(worlds=worlds, fooled=both, afr=both / worlds if worlds else None)


def summarise_distances(samples: Mu, queries: Mu) -> Distances | None:
    """Measure how far samples lie from the nearest of some queries; None without queries."""
    if not len(queries):
        return None
    distances: npt.NDArray[np.float64] = nearest_neighbours(samples, queries)[0]
    return Distances(
        minimum=float(distances.min()),
        median=float(np.median(distances)),
        mean=float(distances.mean()),
        maximum=float(distances.max()),
    )


def image_novelty(neighbours: Sequence[Neighbours], ideal: Sequence[Neighbours]) -> ImageNovelty:
    """Sum up what the comparison of images gave for an adversary's samples and ideal ones."""
    return ImageNovelty(
        samples=len(neighbours),
        median=_median([pair.in_image for pair in neighbours]),
        median_of_nearest_mu=_median([pair.in_mu for pair in neighbours]),
        ideal=_median([pair.in_image for pair in ideal]) if ideal else None,
    )


def _median(neighbours: Sequence[Neighbour]) -> float:
    return float(np.median([neighbour.pixel_distance for neighbour in neighbours]))
