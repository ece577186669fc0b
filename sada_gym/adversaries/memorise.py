"""`memorise`: repeats the queries that fooled, as the control for what memorising scores."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.evaluations import Evaluations
from sada_gym.parameters import Mu

MEMORISED = "samples are queries of the training: a control, never ranked"


class Memorise(FittedAdversary):
    """Replays the points of a uniform pool that fooled: a control, never ranked.

    It learns no distribution. Its AFR is what memorising scores: 1 if Q depends only on mu, less
    if the world is random and some points fooled by luck. Other adversaries draw fresh samples;
    here every sample is a query. If more samples are drawn than points fooled, each point is used
    once before any is used again.
    """

    name: ClassVar[str] = "memorise"
    packages = ()
    uniform_queries: ClassVar[bool] = True

    def fit(self, queries: Evaluations) -> None:
        self.flags = [MEMORISED]
        self._points = self._select_fooling(queries).chosen

    def draw(self, n: int) -> Mu:
        rounds = -(-n // len(self._points))
        order = [self.rng.permutation(len(self._points)) for _ in range(rounds)]
        return self._points[np.concatenate([*order, np.zeros(0, np.intp)])[:n].astype(np.intp)]

    _fresh = draw  # samples may repeat
