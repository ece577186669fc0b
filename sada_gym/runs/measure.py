"""What is measured of a run: the adversary's test samples, and its search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import numpy.typing as npt

from sada_gym.evaluation.oracle import Evaluations
from sada_gym.files import Strict
from sada_gym.measures.coverage import fooling_coverage, relative_coverage
from sada_gym.measures.novelty import Neighbour, Neighbours, novelty, relative_novelty
from sada_gym.measures.rates import attack_fooling_rate, mu_std, nearest_neighbours
from sada_gym.measures.search import SearchPoint, anytime
from sada_gym.parameters import Mu


class Distances(Strict):
    """Distances from the test samples to their nearest neighbours among some queries."""

    minimum: float
    median: float
    mean: float
    maximum: float


class FeasibleRate(Strict):
    """The attack fooling rate over those test samples whose worlds a privileged agent masters.

    Attributes:
        worlds: How many they are.
        fooled: In how many of them the agent is fooled.
        afr: The share; None where there are none.
    """

    worlds: int
    fooled: int
    afr: float | None


class MuNovelty(Strict):
    """Distances from the test samples to the nearest training query, in [-1, 1]^d.

    Attributes:
        median: Over the samples.
        fifth_percentile: Near 0 where a twentieth of the samples or more are hardly new.
        minimum: Of all.
        repeats: Number of samples that are a query.
        ratio: The median over that of ideal samples; None without a reference set.
        fifth_ratio: The fifth percentile likewise.
    """

    median: float
    fifth_percentile: float
    minimum: float
    repeats: int
    ratio: float | None
    fifth_ratio: float | None


class ImageNovelty(Strict):
    """Distances of images of a few samples to the nearest query's, root mean square of pixels.

    Attributes:
        samples: How many were compared.
        median: To the nearest image found.
        median_of_nearest_mu: To the image of the query that is nearest in mu.
        ideal: The median for as many ideal samples; None without a reference set.
    """

    samples: int
    median: float
    median_of_nearest_mu: float
    ideal: float | None

    @property
    def ratio(self) -> float | None:
        """The median over that of ideal samples."""
        return self.median / self.ideal if self.ideal else None


class Measures(Strict):
    """What is measured of the test samples.

    Attributes:
        afr: The attack fooling rate.
        afr_interval_95: Its Wilson interval.
        fooled: Number of samples that fooled.
        mean_score: Their mean Q.
        mu_std: Their spread; 0.577 where uniform.
        density: See `sada_gym.measures.coverage`; None without a reference set, as the next two.
        coverage: Share of the fooling set that the samples which fool cover.
        relative_coverage: Coverage over that of the ideal samples of the same seed.
        novelty: None without training queries.
        image_novelty: None where no images were compared.
        feasible: The rate over feasible worlds; None where no privileged agent is known.
    """

    afr: float
    afr_interval_95: tuple[float, float]
    fooled: int
    mean_score: float
    mu_std: float
    density: float | None
    coverage: float | None
    relative_coverage: float | None
    novelty: MuNovelty | None
    image_novelty: ImageNovelty | None
    feasible: FeasibleRate | None = None


class SearchCheckpoint(Strict):
    """A point of the anytime curve, see `sada_gym.measures.search.SearchPoint`."""

    queries: int
    found: int
    share: float
    coverage: float | None


class Search(Strict):
    """What the training queries found.

    Attributes:
        queries: Queries spent.
        fooled: How many of them fooled.
        curve: At 100, 200, 500, 1,000 and so on, and at the last.
    """

    queries: int
    fooled: int
    curve: tuple[SearchCheckpoint, ...]

    @property
    def fooling_rate(self) -> float | None:
        """The share that fooled; None without queries. Where they are uniform, the random rate."""
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
    """Measure an adversary's test samples.

    Args:
        samples: The M test samples, evaluated.
        queries: The training queries.
        threshold: The fooling threshold epsilon.
        fooling_set: (R, d) points known to fool; None where none are known.
        ideal: M ideal samples, evaluated on the same seeds; None without a fooling set.
        images: What the comparison of images gave.
        seed: Fixes the draws of reference points.
        feasible: The rate over feasible worlds; None where no privileged agent is known.
    """
    rate = attack_fooling_rate(samples.score, threshold)
    density = coverage = relative = None
    if fooling_set is not None and ideal is not None:
        ours, truth = (
            fooling_coverage(of.mu, of.score <= threshold, fooling_set, seed=seed)
            for of in (samples, ideal)
        )
        density, coverage = ours.density, ours.coverage
        relative = relative_coverage(coverage, truth.coverage) if truth.coverage else None
    return Measures(
        afr=rate.rate,
        afr_interval_95=(rate.low, rate.high),
        fooled=rate.fooled,
        mean_score=float(samples.score.mean()),
        mu_std=mu_std(samples.mu),
        density=density,
        coverage=coverage,
        relative_coverage=relative,
        novelty=_mu_novelty(samples, queries, ideal),
        image_novelty=images,
        feasible=feasible,
    )


def follow_search(queries: Evaluations, threshold: float, *, fooling_set: Mu | None) -> Search:
    """Measure what the training queries found.

    Args:
        queries: In the order of asking.
        threshold: The fooling threshold epsilon.
        fooling_set: (R, d) points known to fool; None where none are known.
    """
    at = checkpoints(len(queries))
    curve: tuple[SearchPoint, ...] = ()
    if at:
        curve = anytime(queries.mu, queries.score, threshold, fooling_set, at)
    return Search(
        queries=len(queries),
        fooled=int((queries.score <= threshold).sum()),
        curve=tuple(SearchCheckpoint(**asdict(point)) for point in curve),
    )


def checkpoints(queries: int) -> list[int]:
    """Numbers of queries at which a search is measured: 100, 200, 500, ... and the last."""
    usual = [step * 10**power for power in range(2, 10) for step in (1, 2, 5)]
    return [*(count for count in usual if count < queries), *([queries] if queries else [])]


def feasible_rate(
    fooled: npt.NDArray[np.bool_], feasible: npt.NDArray[np.bool_] | None
) -> FeasibleRate | None:
    """Sum up `Application.feasible`.

    Args:
        fooled: (M,) which test samples fool the agent.
        feasible: (M,) which of them a privileged agent masters; None where none is known.
    """
    if feasible is None:
        return None
    worlds, both = int(feasible.sum()), int((fooled & feasible).sum())
    return FeasibleRate(worlds=worlds, fooled=both, afr=both / worlds if worlds else None)


def nearest_distances(samples: Mu, queries: Mu) -> Distances | None:
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


def _mu_novelty(
    samples: Evaluations, queries: Evaluations, ideal: Evaluations | None
) -> MuNovelty | None:
    if not len(queries):
        return None
    if ideal is None:
        return MuNovelty(**asdict(novelty(samples.mu, queries.mu)), ratio=None, fifth_ratio=None)
    found = relative_novelty(samples.mu, ideal.mu, queries.mu)
    return MuNovelty(**asdict(found.samples), ratio=found.ratio, fifth_ratio=found.fifth_ratio)


def image_novelty(found: Sequence[Neighbours], ideal: Sequence[Neighbours]) -> ImageNovelty:
    """Sum up what the comparison of images gave for an adversary's samples and ideal ones."""
    return ImageNovelty(
        samples=len(found),
        median=_median([one.in_image for one in found]),
        median_of_nearest_mu=_median([one.in_mu for one in found]),
        ideal=_median([one.in_image for one in ideal]) if ideal else None,
    )


def _median(neighbours: Sequence[Neighbour]) -> float:
    return float(np.median([neighbour.pixel_distance for neighbour in neighbours]))
