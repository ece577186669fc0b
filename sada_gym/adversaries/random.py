"""`random`: uniform mu, the baseline that every other adversary has to beat."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.evaluations import Evaluations
from sada_gym.parameters import Mu


class Random(FittedAdversary):
    """Samples mu uniformly and learns nothing: its AFR is the share of the box that fools.

    Training spends no query, because none would change a sample.
    """

    name: ClassVar[str] = "random"
    packages = ()

    def query(self, oracle: Query) -> Evaluations:  # noqa: ARG002 - there is nothing to ask
        return Evaluations.unseeded(self._uniform(0), np.zeros(0))

    def fit(self, queries: Evaluations) -> None:
        """Learn nothing."""

    def draw(self, n: int) -> Mu:
        return self._uniform(n)

    _fresh = draw
