"""`trees`: a plain classifier of what fooled, and rejection. The simplest adversary that works."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier

from sada_gym.adversaries.learner import NONE_FOOLED, Floats, Learner
from sada_gym.adversaries.models.mixture import Array
from sada_gym.adversaries.omega import Omega
from sada_gym.adversaries.options import Options, option
from sada_gym.parameters import Mu

_POOL = 20_000
_MOST_POOLS = 10


@dataclass(frozen=True)
class TreesOptions(Options):
    """The options of `trees`.

    Attributes:
        trees: Number of trees.
        level: A candidate is kept where at least this share of the trees says that it fools.
    """

    trees: int = option(500, 1, 100_000)
    level: float = option(0.5, 0, 1)


class Trees(Learner):
    """Extremely randomised trees (Geurts et al. 2006) on uniform queries, sampled by rejection.

    The reference for every adversary that learns a surrogate: thirty lines around scikit-learn.
    Where no candidate of 200,000 reaches the level, the likeliest are taken. See `TreesOptions`.
    """

    name: ClassVar[str] = "trees"
    packages = ("scikit-learn",)
    uniform_queries = True
    options_class = TreesOptions
    options: TreesOptions

    def _fit(self, omega: Omega) -> None:
        fooled = omega.score <= self.threshold
        if not fooled.any():
            self.flags.append(NONE_FOOLED)
            fooled = omega.score <= np.sort(omega.score)[len(omega) // 100]
        self._forest = ExtraTreesClassifier(
            self.options.trees, random_state=int(self.rng.integers(2**31))
        ).fit(omega.mu, fooled)

    def _draw(self, n: int) -> Floats:
        pools: list[Mu] = []
        predicted: list[Array] = []
        for _ in range(_MOST_POOLS):
            pool = self._uniform(_POOL)
            # one column where every query fooled, or none
            p = self._forest.predict_proba(pool)[:, -1]
            kept: Mu = pool[p >= self.options.level]
            if len(kept):
                return kept
            pools.append(pool)
            predicted.append(p)
        likeliest = np.argsort(-np.concatenate(predicted), kind="stable")[:n]
        return np.concatenate(pools)[likeliest]
