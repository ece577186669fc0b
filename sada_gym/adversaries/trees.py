"""`trees`: a plain classifier of what fooled, and rejection. The simplest adversary that works."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier

from sada_gym.adversaries.fitted import NONE_FOOLED, FittedAdversary
from sada_gym.adversaries.options import Options, option
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats

_POOL, _PART = 200_000, 20_000


@dataclass(frozen=True)
class TreesOptions(Options):
    """The options of `trees`: their number, and the share (`level`) that must vote for a sample."""

    trees: int = option(500, 1, 100_000)
    level: float = option(0.5, 0, 1)


class Trees(FittedAdversary):
    """Extremely randomised trees (Geurts et al. 2006) on uniform queries, sampled by rejection.

    A simple baseline: about thirty lines of code that call scikit-learn. If none of 200,000
    candidates reaches the level, the likeliest are taken. See `TreesOptions`.
    """

    name: ClassVar[str] = "trees"
    packages = ("scikit-learn",)
    uniform_queries = True
    options_class = TreesOptions
    options: TreesOptions

    def fit(self, queries: Evaluations) -> None:
        fooled = queries.fooled(self.threshold)
        if not fooled.any():
            self.flags.append(NONE_FOOLED)
            fooled = queries.score <= np.sort(queries.score)[len(queries) // 100]
        self._forest = ExtraTreesClassifier(
            self.options.trees, random_state=int(self.rng.integers(2**31))
        ).fit(queries.mu, fooled)

    def draw(self, n: int) -> AnyFloats:
        pool, p = self._uniform(0), np.zeros(0)
        while len(pool) < _POOL:
            drawn = self._uniform(_PART)
            # one column where every query fooled, or none
            p = np.append(p, self._forest.predict_proba(drawn)[:, -1])
            pool = np.concatenate([pool, drawn])
            kept = pool[p >= self.options.level]
            if len(kept):
                return kept
        return pool[np.argsort(-p, kind="stable")[:n]]
