"""The base class of `svm` and `gp`: predict the score of random mu, and take the lowest."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.adversaries.options import Options, option
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats, Floats

NONE_FOOLED_BUT_ALL_LEARNT = "no point of Omega fooled: the lowest predicted scores may not either"

_MIN_POOL = 4


@dataclass(frozen=True)
class SelectionOptions(Options):
    """The options of `svm` and `gp`.

    Attributes:
        pool: The number of random mu that samples are selected from; None takes as many as Omega
            has. The pool is always at least four times as large as the sample.
        subset: Hyper-parameters are chosen on at most this many points; the final fit uses all.
    """

    pool: int | None = option(None, 1, 10**6, kind=int)
    subset: int = option(2_000, 10, 10_000)


class Selection(FittedAdversary):
    """Learns to predict Q from all of Omega; samples are the lowest of a fresh random pool.

    The paper does not say how many random mu it sorts by their predicted score. A large pool gives
    only the extremes of the prediction, a small one nearly the whole box. Here the pool is as large
    as Omega. Each call draws a new pool; ties are broken at random. See `SelectionOptions`.
    """

    uniform_queries: ClassVar[bool] = True
    options_class = SelectionOptions
    options: SelectionOptions

    @abstractmethod
    def _predict(self, mu: Floats) -> AnyFloats:
        """Predict a value for mu (n, d): (n,). The samples are the mu of the lowest values."""

    def _train(self, oracle: Query) -> Evaluations:
        queries = self.query(oracle)
        if not queries.fooled(self.threshold).any():
            self.flags.append(NONE_FOOLED_BUT_ALL_LEARNT)
        # more threads would give other last bits
        with threadpool_limits(1):
            self.fit(queries)
        return queries

    def draw(self, n: int) -> AnyFloats:
        size = max(self.options.pool or len(self.queries), _MIN_POOL * n)
        pool = self.rng.uniform(-1.0, 1.0, (size, self.dimension))
        with threadpool_limits(1):
            predicted = self._predict(pool)
        # the pool has no order, so a stable sort breaks ties at random
        lowest = np.argsort(predicted, kind="stable")[:n]
        return pool[np.sort(lowest)]
