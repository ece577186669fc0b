"""The next query of Bayesian optimisation: the candidate of the largest expected improvement."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr
from scipy.stats import qmc

from sada_gym.adversaries.models.arrays import Floats, Floats32, Indices
from sada_gym.adversaries.models.mixture import reflect
from sada_gym.adversaries.models.pool_posterior import Matern, PoolPosterior, fit_matern
from sada_gym.errors import AdversaryError

MIN_CANDIDATES = 512

_FIT_POINTS = 1024
_ROUND, _CENTRES, _NEIGHBOURS = 8, 8, 4
_NEAREST, _FARTHEST = -2.0, -0.5
_WATCHED = 256


def expected_improvement(mean: Floats, deviation: Floats, incumbent: float) -> Floats:
    """Return how far below the incumbent, the least value so far, normal variables (m,) will fall.

    Jones, Schonlau & Welch 1998 ("Efficient global optimization of expensive black-box functions"),
    equation 15. Deviations are positive.
    """
    gap = incumbent - mean
    u = gap / deviation
    improvement: Floats = gap * ndtr(u) + deviation * np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi)
    return improvement


def lowest(values: Floats, count: int) -> Indices:
    """Return the indices of the lowest values, lowest first, earlier ones first among equals."""
    if count < len(values):
        among = np.flatnonzero(values <= np.partition(values, count - 1)[count - 1])
    else:
        among = np.arange(len(values))
    return among[np.argsort(values[among], kind="stable")[:count]]


class ImprovementSearch:
    """Chooses points one after another under one fit of the kernel.

    The candidates are a scrambled Sobol sequence. Every 8 steps, neighbours of the best candidates
    replace those of the least expected improvement, which refines the search where it is worth it.
    Of the evaluated points, those of the 256 lowest posterior means stay among the candidates.

    At least one mu, (n, d) float32, was evaluated before. The fit starts from a kernel, or from the
    prior's mode. The candidates are a power of two, the capacity the most evaluations, those of
    before included.
    """

    def __init__(
        self,
        mu: Floats32,
        score: Floats,
        kernel: Matern | None,
        rng: np.random.Generator,
        *,
        candidates: int,
        capacity: int,
    ) -> None:
        self._rng = rng
        self._offset, self._scale = score.mean(), score.std() or 1.0
        values = self._standardise(score)
        some = rng.permutation(len(mu))[:_FIT_POINTS]
        self.kernel = fit_matern(mu[some], values[some], kernel)
        sobol = qmc.Sobol(mu.shape[1], rng=rng).random(candidates)
        pool = (2.0 * sobol - 1.0).astype(np.float32)
        self._posterior = PoolPosterior(self.kernel, pool, mu, values, capacity=capacity)
        self._known = {row.tobytes() for row in mu}
        self.evaluated = np.zeros(candidates, bool)
        self._steps = 0

        best = np.argsort(self._posterior.mean_at_observations(), kind="stable")[:_WATCHED]
        self._posterior.replace(np.arange(len(best)), mu[best])
        self.evaluated[: len(best)] = True

    def choose(self) -> Floats32:
        """Return the candidate (d,) of the largest expected improvement, never one evaluated."""
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
            self.evaluated[index], improvement[index] = True, -1.0
            index = int(np.argmax(improvement))
        point: Floats32 = self._posterior.pool[index].copy()
        self._known.add(point.tobytes())
        self.evaluated[index] = True
        self._posterior.condition(index)
        return point

    def observe(self, scores: Floats) -> None:
        """Take in the scores of what was chosen since the last call."""
        self._posterior.observe(self._standardise(scores))

    def _standardise(self, scores: Floats) -> Floats:
        values: Floats = (scores - self._offset) / self._scale
        return values

    def _improvement(self) -> Floats:
        mean = self._posterior.mean
        deviation = np.sqrt(np.maximum(self._posterior.variance, 1e-12))
        incumbent = float(mean[self.evaluated].min())
        improvement = expected_improvement(mean, deviation, incumbent)
        improvement[self.evaluated] = -1.0
        return improvement

    def _refine(self) -> None:
        """Put neighbours of the best candidates in place of the worst, and of evaluated ones.

        The evaluated ones of the lowest means stay: the incumbent is one of them.
        """
        improvement = self._improvement()
        evaluated = np.flatnonzero(self.evaluated)
        worth = improvement.copy()
        worth[evaluated[lowest(self._posterior.mean[evaluated], _WATCHED)]] = np.inf
        slots = lowest(worth, _CENTRES * _NEIGHBOURS)
        best = lowest(-improvement, _CENTRES)
        centres = np.repeat(self._posterior.pool[best], _NEIGHBOURS, axis=0)
        radius = 10.0 ** self._rng.uniform(_NEAREST, _FARTHEST, (len(centres), 1))
        # beyond 1 a longer scale only means that the dimension does not matter
        step = radius * np.minimum(self.kernel.length_scales, 1.0)
        moved = reflect(centres + step * self._rng.normal(size=centres.shape))
        self._posterior.replace(slots, moved.astype(np.float32) + np.float32(0.0))
        self.evaluated[slots] = False
