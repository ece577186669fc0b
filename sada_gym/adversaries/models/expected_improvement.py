"""Bayesian optimisation: minimises Q by expected improvement, exactly, for thousands of steps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr
from scipy.stats import qmc
from threadpoolctl import ThreadpoolController

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.models.pool_posterior import Array, Matern, PoolPosterior, fit_matern
from sada_gym.adversaries.omega import Omega, evaluate
from sada_gym.errors import AdversaryError

LEAST_CANDIDATES = 512

_FIT_POINTS = 1024
_ROUND, _CENTRES, _NEIGHBOURS = 8, 8, 4
_NEAREST, _FARTHEST = -2.0, -0.5
_WATCHED = 256
_LEAST_GROWTH = 1.5


def expected_improvement(mean: Array, deviation: Array, incumbent: float) -> Array:
    """Give how far below the incumbent normal variables are expected to fall: (m,).

    Jones, Schonlau & Welch 1998 ("Efficient global optimization of expensive black-box functions"),
    equation 15.

    Args:
        mean: (m,).
        deviation: (m,), positive.
        incumbent: The least value so far.
    """
    gap = incumbent - mean
    u = gap / deviation
    improvement: Array = gap * ndtr(u) + deviation * np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi)
    return improvement


def minimise(
    oracle: Query,
    omega: Omega,
    rng: np.random.Generator,
    *,
    candidates: int = 16_384,
    batch: int = 1,
) -> Omega:
    """Spend the oracle's remaining budget where Q is expected to improve most.

    Each step asks for the candidate of the largest expected improvement under a Gaussian process
    fitted to all evaluations. Q is noisy, so the incumbent is not the lowest score but the lowest
    posterior mean at an evaluated point (Picheny, Wagner & Ginsbourger 2013, "A benchmark of
    kriging-based infill criteria for noisy optimization": expected improvement with plug-in). Of
    the evaluated points, those of the 256 lowest means stay among the candidates to be watched.

    The candidates are a scrambled Sobol sequence. Every 8 steps those of the least expected
    improvement give way to neighbours of the best ones, which refines the search where it is worth
    it. Kernel and candidates are renewed where the evaluations have doubled, so that the
    factorisations from scratch cost a third of the steps.

    Args:
        oracle: Answers the queries.
        omega: What was evaluated before, at least one point.
        rng: All randomness.
        candidates: Number of candidates, a power of two.
        batch: Points asked for at once. Within a batch each is taken to score its posterior mean
            until the scores arrive ("kriging believer": Ginsbourger, Le Riche & Carraro 2010,
            "Kriging is well-suited to parallelize optimization").

    Returns:
        All evaluations, those of `omega` first, in order.

    Raises:
        ValueError: If a score is not finite.
    """
    # one thread: the last bits of a product, and so the search, depend on their number
    blas = ThreadpoolController()
    kernel = None
    for stop in stages(len(omega), len(omega) + oracle.remaining):
        with blas.limit(limits=1, user_api="blas"):
            search = _Search(omega, kernel, rng, candidates=candidates, capacity=stop)
        while len(omega) < stop:
            with blas.limit(limits=1, user_api="blas"):
                chosen = [search.choose() for _ in range(min(batch, stop - len(omega)))]
            found = evaluate(np.array(chosen), oracle)
            with blas.limit(limits=1, user_api="blas"):
                search.observe(found.score)
            omega += found
        kernel = search.kernel
        del search  # the next one needs as much memory again
    return omega


def stages(start: int, stop: int) -> list[int]:
    """Give the numbers of evaluations at which to begin anew: halvings of stop, and stop itself."""
    ends = []
    while stop > start:
        ends.append(stop)
        stop //= 2
        if stop < _LEAST_GROWTH * start:
            break
    return ends[::-1]


class _Search:
    """The choice of points, from one fit of the kernel to the next."""

    def __init__(
        self,
        omega: Omega,
        kernel: Matern | None,
        rng: np.random.Generator,
        *,
        candidates: int,
        capacity: int,
    ) -> None:
        self._rng = rng
        self._offset, self._scale = omega.score.mean(), omega.score.std() or 1.0
        values = self._standardise(omega.score)
        some = rng.permutation(len(omega))[:_FIT_POINTS]
        self.kernel = fit_matern(omega.mu[some], values[some], kernel)
        sobol = qmc.Sobol(omega.mu.shape[1], rng=rng).random(candidates)
        pool = (2.0 * sobol - 1.0).astype(np.float32)
        self._posterior = PoolPosterior(self.kernel, pool, omega.mu, values, capacity=capacity)
        self._known = {row.tobytes() for row in omega.mu}
        self._evaluated = np.zeros(candidates, bool)
        self._steps = 0

        best = np.argsort(self._posterior.mean_at_observations(), kind="stable")[:_WATCHED]
        self._posterior.replace(np.arange(len(best)), omega.mu[best])
        self._evaluated[: len(best)] = True

    def choose(self) -> npt.NDArray[np.float32]:
        """Give the candidate (d,) of the largest expected improvement, never one evaluated."""
        if self._steps % _ROUND == 0:
            self._refine()
        self._steps += 1
        improvement = self._improvement()
        index = int(np.argmax(improvement))
        while self._posterior.pool[index].tobytes() in self._known:
            if improvement[index] <= -1.0:
                raise AdversaryError(
                    "Expected a candidate that was not evaluated yet, but none is left. Raise the "
                    "option candidates, or lower the budget."
                )
            self._evaluated[index], improvement[index] = True, -1.0
            index = int(np.argmax(improvement))
        point: npt.NDArray[np.float32] = self._posterior.pool[index].copy()
        self._known.add(point.tobytes())
        self._evaluated[index] = True
        self._posterior.condition(index)
        return point

    def observe(self, scores: Array) -> None:
        """Take in the scores of what was chosen since the last call."""
        self._posterior.observe(self._standardise(scores))

    def _standardise(self, scores: Array) -> Array:
        values: Array = (scores - self._offset) / self._scale
        return values

    def _improvement(self) -> Array:
        """Give each candidate's expected improvement, -1 where it was evaluated."""
        mean = self._posterior.mean
        deviation = np.sqrt(np.maximum(self._posterior.variance, 1e-12))
        incumbent = float(mean[self._evaluated].min())
        improvement = expected_improvement(mean, deviation, incumbent)
        improvement[self._evaluated] = -1.0
        return improvement

    def _refine(self) -> None:
        """Put neighbours of the best candidates in place of the worst, and of evaluated ones.

        The evaluated ones of the lowest means stay: the incumbent is one of them.
        """
        improvement = self._improvement()
        evaluated = np.flatnonzero(self._evaluated)
        lowest = np.argsort(self._posterior.mean[evaluated], kind="stable")[:_WATCHED]
        worth = improvement.copy()
        worth[evaluated[lowest]] = np.inf
        slots = np.argsort(worth, kind="stable")[: _CENTRES * _NEIGHBOURS]
        best = np.argsort(-improvement, kind="stable")[:_CENTRES]
        centres = np.repeat(self._posterior.pool[best], _NEIGHBOURS, axis=0)
        radius = 10.0 ** self._rng.uniform(_NEAREST, _FARTHEST, (len(centres), 1))
        # beyond 1 a longer scale only means that the dimension does not matter
        step = radius * np.minimum(self.kernel.length_scales, 1.0)
        moved = reflect(centres + step * self._rng.normal(size=centres.shape))
        self._posterior.replace(slots, moved.astype(np.float32) + np.float32(0.0))
        self._evaluated[slots] = False
