"""How new samples are: distances to the training queries, in mu and between images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats32, as_array
from sada_gym.foundations.files import Strict
from sada_gym.foundations.frames import Frame
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.measures.rates import nearest_neighbours


class Novelty(Strict):
    """Euclidean distances in [-1, 1]^d from samples to their nearest training queries.

    Attributes:
        fifth_percentile: It is near 0 where a twentieth of the samples or more are hardly new.
        repeats: Number of samples that are a query, to the last bit of float32.
        ratio: The median over that of ideal samples: about 1 where the samples are as new as the
            truth's, near 0 where they are stored queries, shaken or not. None without ideal
            samples.
        fifth_ratio: The fifth percentile over that of ideal samples: it is small already where
            only some of the samples are stored queries.
    """

    median: float
    fifth_percentile: float
    minimum: float
    repeats: int
    ratio: float | None = None
    fifth_ratio: float | None = None


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A training query near a sample, by its row, drawn with the sample's seed.

    Distances are Euclidean: of mu in [-1, 1]^d, and of whole images with pixels from -1 to 1, as in
    the paper.
    """

    query: int
    frame: Frame
    mu_distance: float
    image_distance: float

    @property
    def pixel_distance(self) -> float:
        """Return the root mean square over the pixels' values, which holds for any image's size."""
        return float(self.image_distance / self.frame.size**0.5)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """A sample, (d,), and the training queries nearest to it, in mu and, of those drawn, as images.

    All three images have one evaluation seed: shape and place are the same.
    """

    mu: Floats32
    seed: int
    frame: Frame
    in_mu: Neighbour
    in_image: Neighbour


def novelty(samples: npt.ArrayLike, queries: npt.ArrayLike) -> Novelty:
    """Measure how far samples, (m, d), lie from the training queries, (n, d), m and n >= 1.

    Both are rounded to float32, as mu is wherever it is evaluated. Raise `UserError` if the shapes
    do not fit.
    """
    points = as_array(samples, "samples").astype(np.float32)
    distances, _ = nearest_neighbours(points, as_array(queries, "queries").astype(np.float32))
    if not len(distances):
        raise UserError(f"Expected at least one sample, got shape {points.shape}.")
    return Novelty(
        median=float(np.median(distances)),
        fifth_percentile=float(np.percentile(distances, 5)),
        minimum=float(distances.min()),
        repeats=int((distances == 0.0).sum()),
    )


def relative_novelty(
    samples: npt.ArrayLike, ideal: npt.ArrayLike, queries: npt.ArrayLike
) -> Novelty:
    """Compare the novelty of an adversary's samples, (m, d), with that of ideal ones, (l, d).

    Ideal samples are uniform in the true fooling set and independent of the queries, (n, d). They
    say how near the queries any good sample must lie: a thorough search leaves no place that is far
    from all of them.

    Raises:
        ValueError: If the shapes do not fit, or the ideal samples are themselves queries.
    """
    ours, truth = novelty(samples, queries), novelty(ideal, queries)
    if truth.fifth_percentile == 0.0:
        raise UserError(
            f"Expected ideal samples that were not queried, got {truth.repeats} that were. Draw "
            "them independently of the queries."
        )
    ratio, fifth = ours.median / truth.median, ours.fifth_percentile / truth.fifth_percentile
    return ours.model_copy(update={"ratio": ratio, "fifth_ratio": fifth})


def image_neighbours(
    application: Application,
    samples: npt.ArrayLike,
    seeds: Sequence[int],
    queries: npt.ArrayLike,
    *,
    neighbours: int = 16,
    others: int = 16,
    seed: int = 0,
    frame: Callable[[Floats32, int], Frame] | None = None,
) -> tuple[Neighbours, ...]:
    """Find the training queries nearest to samples, in mu and in image space.

    The paper's figure "Nearest Neighbor in Training", with two differences. All images beside a
    sample are drawn with the sample's own seed, so that mu alone sets them apart. And the nearest
    image is looked for among so many `neighbours`, the nearest queries in mu, and `others`, random
    ones that `seed` picks. Samples are (m, d), 8 to 16 for a figure, with a seed each; queries are
    (n, d). `frame` draws the image of a mu, (d,), and a seed: by default `application.observation`.
    Where the application draws no images, nothing is returned. Raise `UserError` for arguments that
    do not fit together.
    """
    points, queried = (application.parameters.validate(mu) for mu in (samples, queries))
    worlds = validate_seeds(seeds, len(points))
    if neighbours < 1 or others < 0 or not len(queried):
        raise UserError(
            "Expected at least 1 query, neighbours >= 1 and others >= 0, got "
            f"{len(queried)} queries, neighbours={neighbours}, others={others}."
        )
    draw, rng = frame or application.observation, np.random.default_rng(seed)
    compared = []
    for mu, world in zip(points, worlds, strict=True):
        distances = np.linalg.norm(queried.astype(np.float64) - mu, axis=1)
        order = np.argsort(distances, kind="stable")
        rest = order[neighbours:]
        random = rng.choice(rest, min(others, len(rest)), replace=False)
        try:
            picture = draw(mu, world)
        except NotImplementedError:
            return ()
        near = [
            _neighbour(int(row), draw(queried[row], world), float(distances[row]), picture)
            for row in (*order[:neighbours], *random)
        ]
        nearest = min(near, key=lambda neighbour: neighbour.image_distance)
        compared.append(Neighbours(mu, world, picture, near[0], nearest))
    return tuple(compared)


def _neighbour(row: int, frame: Frame, distance: float, sample: Frame) -> Neighbour:
    difference = (frame.astype(np.float64) - sample) / 127.5
    return Neighbour(row, frame, distance, float(np.linalg.norm(difference)))
