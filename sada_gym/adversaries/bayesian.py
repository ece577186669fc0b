"""`bayesian`: expected improvement, then a Gaussian mixture on the last points that fool."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from threadpoolctl import ThreadpoolController

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.gaussian_mixture import MixtureAdversary
from sada_gym.adversaries.models.expected_improvement import MIN_CANDIDATES, ImprovementSearch
from sada_gym.adversaries.models.mixture import fit_best_mixture
from sada_gym.adversaries.options import Options, option
from sada_gym.adversaries.query_pool import evaluate, evaluate_uniform, select_fooling
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations

_MIN_GROWTH = 1.5


@dataclass(frozen=True)
class BayesianOptions(Options):
    """The options of `bayesian`.

    Attributes:
        initial: The number of uniform points at the start, at most the budget. None takes 10 d
            (Jones, Schonlau & Welch 1998), but at most a quarter of the budget.
        last: S is selected from this many of the last evaluations.
        induced_size: s, the largest size of S; 0 for all points that fool.
        components: The sizes of mixtures to try.
        candidates: The number of points that each step chooses from, a power of two.
        batch: The number of points evaluated at once, for parallel workers.
    """

    initial: int | None = option(None, 1, 10**9, kind=int)
    last: int = option(1000, 1, 10**9)
    induced_size: int = option(100, 0, 10**9)
    components: tuple[int, ...] = option((1, 2, 4, 8, 16, 32), 1, 1_000)
    candidates: int = option(16_384, MIN_CANDIDATES, 2**17)
    batch: int = option(1, 1, 10_000)

    def __post_init__(self) -> None:
        """Check every option."""
        super().__post_init__()
        if self.candidates & (self.candidates - 1):
            raise UserError(
                "Expected candidates to be a power of two, as a Sobol sequence wants it, "
                f"got {self.candidates}."
            )


class Bayesian(MixtureAdversary):
    """Minimises Q by expected improvement, and fits a Gaussian mixture to the lowest late points.

    This is the Bayesian baseline of the paper (section "Baselines"), with the oracle's budget as
    the number of steps. Of mixtures of several sizes it takes the one with the best cross-validated
    likelihood. Draws outside the box are drawn again. See `BayesianOptions`.
    """

    name: ClassVar[str] = "bayesian"
    options_class = BayesianOptions
    options: BayesianOptions

    def query(self, oracle: Query) -> Evaluations:
        o, budget = self.options, oracle.remaining
        initial = o.initial or min(10 * self.dimension, max(budget // 4, 1))
        queries = evaluate_uniform(min(initial, budget), self.dimension, oracle, self.rng)
        return minimise(oracle, queries, self.rng, candidates=o.candidates, batch=o.batch)

    def fit(self, queries: Evaluations) -> None:
        o = self.options
        late = queries[-o.last :]
        induced = select_fooling(late, self.threshold, self.rng, size=o.induced_size or None)
        if induced.fallback:
            self.flags.append(
                f"none of the last {len(late)} points fooled: learnt from the lowest scores instead"
            )
        self._mixture = fit_best_mixture(induced.chosen, o.components, self.rng)


def minimise(
    oracle: Query,
    queries: Evaluations,
    rng: np.random.Generator,
    *,
    candidates: int = 16_384,
    batch: int = 1,
) -> Evaluations:
    """Spend the oracle's remaining budget where Q is expected to improve most.

    Each step asks for the candidate of the largest expected improvement under a Gaussian process
    fitted to all evaluations. Q is noisy, so the incumbent is the lowest posterior mean at an
    evaluated point (expected improvement with plug-in: Picheny, Wagner & Ginsbourger 2013, "A
    benchmark of kriging-based infill criteria for noisy optimization"). Kernel and candidates (see
    `ImprovementSearch`) are renewed whenever the evaluations have doubled. In a batch, a point
    counts as if it scored its posterior mean ("kriging believer": Ginsbourger, Le Riche & Carraro
    2010).

    Returns:
        All evaluations: those of before, `queries`, at least one, and the new ones in order.

    Raises:
        ValueError: If a score is not finite.
    """
    # one thread: the last bits of a product, and so the search, depend on their number
    one_thread = partial(ThreadpoolController().limit, limits=1, user_api="blas")
    kernel = None
    for stop in stages(len(queries), len(queries) + oracle.remaining):
        with one_thread():
            search = ImprovementSearch(
                queries.mu, queries.score, kernel, rng, candidates=candidates, capacity=stop
            )
        while len(queries) < stop:
            with one_thread():
                chosen = [search.choose() for _ in range(min(batch, stop - len(queries)))]
            answers = evaluate(np.array(chosen), oracle)
            with one_thread():
                search.observe(answers.score)
            queries += answers
        kernel = search.kernel
        del search  # the next one needs as much memory again
    return queries


def stages(start: int, stop: int) -> list[int]:
    """Return the numbers of evaluations at which a fit ends: halvings of stop, and stop itself."""
    ends = []
    while stop > start:
        ends.append(stop)
        stop //= 2
        if stop < _MIN_GROWTH * start:
            break
    return ends[::-1]
