"""What `svm` and `gp` share: predict the score of random mu, and take the lowest."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.learner import Learner
from sada_gym.adversaries.omega import Omega, evaluate_uniform
from sada_gym.errors import UserError

NONE_FOOLED_BUT_ALL_LEARNT = "no point of Omega fooled: the lowest predicted scores may not either"

_LEAST_POOL = 4


class Selection(Learner):
    """Learns to predict Q from all of Omega; samples are the lowest of a fresh random pool.

    The paper draws random mu, sorts them by their predicted score and picks the M lowest, but does
    not say out of how many. The size of the pool decides what is selected: a large one gives the
    extremes of the prediction alone, a small one nearly the whole box. Ours is as large as Omega,
    so that the prediction sifts as many points as it was learnt from. It is drawn anew at every
    call, and equal predictions are taken in the random order of the pool.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.
        pool: Random mu that a sample is selected from; None takes as many as Omega has. At least
            four times the sample are drawn in any case, so that a selection remains.
        subset: Points of Omega, at most, that the hyper-parameters are chosen on; the final fit is
            to all.

    Raises:
        ValueError: If the dimension is below 1, the pool below 1, or the subset below 10.
    """

    uniform_queries: ClassVar[bool] = True

    def __init__(
        self,
        dimension: int,
        *,
        seed: int | None = None,
        pool: int | None = None,
        subset: int = 2_000,
    ) -> None:
        super().__init__(dimension, seed=seed)
        for name, value, least in (("pool", pool, 1), ("subset", subset, 10)):
            if value is not None and (not isinstance(value, int) or value < least):
                raise UserError(f"Expected {name} to be an int of at least {least}, got {value}.")
        self.pool = pool
        self.subset = subset

    @property
    def options(self) -> dict[str, Any]:
        """The keywords that make an equal adversary."""
        return {"pool": self.pool, "subset": self.subset}

    @abstractmethod
    def _fit(self, omega: Omega) -> None:
        """Learn to predict the score from all of Omega."""

    @abstractmethod
    def _predict(self, mu: npt.NDArray[np.float64]) -> npt.NDArray[np.floating[Any]]:
        """Predict what the lowest of is selected, for mu (n, d): (n,)."""

    def _train(self, oracle: Query) -> Omega:
        omega = evaluate_uniform(oracle.remaining, self.dimension, oracle, self.rng)
        if (omega.score > oracle.threshold).all():
            self.flags.append(NONE_FOOLED_BUT_ALL_LEARNT)
        # more threads would give other last bits
        with threadpool_limits(1):
            self._fit(omega)
        return omega

    def _draw(self, n: int) -> npt.NDArray[np.floating[Any]]:
        size = max(self.pool or len(self.omega), _LEAST_POOL * n)
        pool = self.rng.uniform(-1.0, 1.0, (size, self.dimension))
        with threadpool_limits(1):
            predicted = self._predict(pool)
        # the pool has no order, so a stable sort breaks ties at random
        lowest = np.argsort(predicted, kind="stable")[:n]
        return pool[np.sort(lowest)]
