"""Other ways for `level-set` to choose its queries, which `designs.py` compares with its own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.level_set import LevelSet
from sada_gym.adversaries.models.surrogate import CrossFittedTrees, Surrogate
from sada_gym.evaluations import Evaluations

Array = npt.NDArray[np.float64]
Pool = npt.NDArray[np.float32]


class MutualInformation(LevelSet):
    """Asks where members disagree, not where each is unsure (BALD, Houlsby et al. 2011).

    The mutual information of answer and model: the entropy of the mean probability, less the mean
    entropy. For level sets see Letham et al. 2022.
    """

    def _acquisition(self, surrogate: Surrogate, pool: Pool, p: Array) -> Array:
        p = members(surrogate, pool)
        gain: Array = _entropy(p.mean(axis=0)) - _entropy(p).mean(axis=0)
        return np.maximum(gain, 0.0)


class Straddle(LevelSet):
    """Asks where the boundary may lie within the members' spread (Bryan et al. 2005).

    The logit of p is linear in the predicted ranks, and zero at the boundary.
    """

    def _acquisition(self, surrogate: Surrogate, pool: Pool, p: Array) -> Array:
        p = members(surrogate, pool)
        logit = np.log(p / (1.0 - p))
        worth: Array = 1.96 * logit.std(axis=0) - np.abs(logit.mean(axis=0))
        return np.maximum(worth, 0.0)


def members(surrogate: Surrogate, pool: Pool) -> Array:
    """The probabilities that each of the four ensembles of trees would give alone: (4, m).

    Each learnt from another three quarters of the queries; they share the Gaussian process.
    """
    trees, process = surrogate.regressions
    assert isinstance(trees, CrossFittedTrees)
    x = pool.astype(np.float64)
    smooth = process(x)
    p = [surrogate.calibrated([ensemble.predict(x), smooth]) for ensemble in trees.ensembles]
    return np.clip(p, 1e-6, 1.0 - 1e-6)


class Own(LevelSet):
    """Spends a share of each round on what it would give as samples by now, as boosted BBGAN does.

    So it learns which of its failures were luck (compare Booth et al. 2023, contour location).
    """

    share = 0.25

    def _acquisition(self, surrogate: Surrogate, pool: Pool, p: Array) -> Array:
        # the level of its samples, before coverage raises it
        volume = self.options.volume * p.mean()
        own = p >= min(0.5, float(np.quantile(p, 1.0 - volume)))
        worth = super()._acquisition(surrogate, pool, p)
        mixed: Array = (1.0 - self.share) * worth / worth.sum() + self.share * own / own.sum()
        return mixed


class OwnHalf(Own):
    """Half of each round."""

    share = 0.5


class OwnLast(Own):
    """All of the last round, and nothing before."""

    share = 0.0

    def query(self, oracle: Query) -> Evaluations:
        self._left = self.options.rounds
        return super().query(oracle)

    def _acquisition(self, surrogate: Surrogate, pool: Pool, p: Array) -> Array:
        self._left -= 1
        self.share = 0.0 if self._left else 1.0
        return super()._acquisition(surrogate, pool, p)


def _entropy(p: Array) -> Array:
    entropy: Array = -p * np.log(p) - (1.0 - p) * np.log1p(-p)
    return entropy
