"""`cma-mae`: quality diversity over the box by CMA-MAE, with pyribs (the extra `qd`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import qmc

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import Arrays, FittedAdversary, validate_array
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform
from sada_gym.errors import MissingExtra, install_line
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats

if TYPE_CHECKING:
    from ribs.schedulers import Scheduler


_THRESHOLD_MIN = -0.01  # below every objective, so that Q = 1 may enter the archive too


@dataclass(frozen=True)
class CMAMAEOptions(Options):
    """The options of `cma-mae`.

    Attributes:
        uniform_share: The share of the budget that is uniform.
        cells: The number of cells of the archive; the fewer, the more queries each gets.
        emitters: The number of evolution strategies.
        learning_rate: The rate at which thresholds rise: 0 optimises, 1 explores as CMA-ME does.
        sigma: The standard deviation that the strategies start with.
    """

    uniform_share: float = option(0.2, 0, 1, inside=True)
    cells: int = option(100, 1, 100_000)
    emitters: int = option(15, 1, 1_000)
    learning_rate: float = option(0.01, 0, 1)
    sigma: float = option(0.2, 0, 1, inside=True)


class CMAMAE(FittedAdversary):
    """Evolution strategies that fill an archive of cells all over the box with low scores.

    This is CMA-MAE (Fontaine & Nikolaidis 2023, "Covariance Matrix Adaptation MAP-Annealing") with
    mu itself as the measure: the cells are the Voronoi cells of a Halton sequence. To draw a sample
    it picks a cell in proportion to the square of its fooling rate, counted over all of its points
    (as in Deep-Grid, Flageat & Cully 2020), and one of its points that fooled. From there it takes
    a Gaussian step, on average half as long as the way to the nearest other fooling point. Training
    raises `ModuleNotFoundError` if ribs is not installed. See `CMAMAEOptions`.
    """

    name: ClassVar[str] = "cma-mae"
    packages = ("scikit-learn", "torch", "numba", "ribs")
    options_class = CMAMAEOptions
    options: CMAMAEOptions

    def query(self, oracle: Query) -> Evaluations:
        try:
            import ribs  # noqa: F401
        except ModuleNotFoundError as error:
            raise MissingExtra(
                f"Expected ribs for cma-mae, but it is not installed. {install_line('qd')}"
            ) from error
        uniform = math.ceil(self.options.uniform_share * oracle.remaining)
        queries = evaluate_uniform(uniform, self.dimension, oracle, self.rng)
        halton = qmc.Halton(self.dimension, rng=self.rng)
        self._centroids = 2.0 * halton.random(self.options.cells) - 1.0
        scheduler = self._scheduler(queries)
        while oracle.remaining:
            proposed = reflect(scheduler.ask()).astype(np.float32)
            part = evaluate(proposed[: oracle.remaining], oracle)
            queries += part
            if len(part) == len(proposed):
                scheduler.tell(1.0 - part.score, part.mu)
        return queries

    def _scheduler(self, queries: Evaluations) -> Scheduler:
        from ribs.archives import CVTArchive
        from ribs.emitters import EvolutionStrategyEmitter
        from ribs.schedulers import Scheduler

        archive = CVTArchive(
            solution_dim=self.dimension,
            centroids=self._centroids,
            ranges=[(-1.0, 1.0)] * self.dimension,
            learning_rate=self.options.learning_rate,
            threshold_min=_THRESHOLD_MIN,
            seed=self._seed(),
        )
        # the uniform points are in the archive already
        archive.add(queries.mu, 1.0 - queries.score, queries.mu)
        elites = archive.data(["solution", "objective"])
        fools = elites["objective"] >= 1.0 - self.threshold
        starts = elites["solution"][fools] if fools.any() else elites["solution"]
        shape = self.options.emitters, self.dimension
        emitters = [
            EvolutionStrategyEmitter(
                archive,
                x0=start,
                sigma0=self.options.sigma,
                ranker="imp",
                selection_rule="mu",
                restart_rule="basic",
                seed=self._seed(),
            )
            for start in np.resize(self.rng.permutation(starts), shape)
        ]
        return Scheduler(archive, emitters)

    def fit(self, queries: Evaluations) -> None:
        chosen = self._select_fooling(queries).chosen
        cells, count = KDTree(self._centroids), len(self._centroids)
        cell = cells.query(chosen)[1]
        tried = np.bincount(cells.query(queries.mu)[1], minlength=count)
        fooled = np.bincount(cell, minlength=count)
        rate = fooled / (tried + 1.0)  # one more, so that a cell hit once is no sure thing
        weight = rate[cell] ** 2 / fooled[cell]
        nearest = KDTree(chosen).query(chosen, k=2)[0][:, 1]
        self._points = chosen
        self._odds = weight / weight.sum()
        self._deviations = np.minimum(0.5 * nearest / np.sqrt(self.dimension), self.options.sigma)

    def draw(self, n: int) -> Floats:
        row = self.rng.choice(len(self._points), n, p=self._odds)
        step = self._deviations[row, None] * self.rng.normal(size=(n, self.dimension))
        return reflect(self._points[row] + step)

    def arrays(self) -> Arrays:
        return {"centroids": self._centroids}

    def restore(self, arrays: Arrays) -> None:
        self._centroids = validate_array(arrays, "centroids", self.options.cells, self.dimension)
        self.fit(self.queries)

    def _seed(self) -> int:
        return int(self.rng.integers(2**31))
