"""Which parameters decide whether the agent fails, and how its chance changes along each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.foundations.determinism import single_threaded
from sada_gym.foundations.files import Strict
from sada_gym.parameters import Mu

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesClassifier

MIN_WORLDS = 100
"""The least number of worlds, and `MIN_KIND` of failures and of others, that anything rests on."""

MIN_KIND = 10

MAX_PARAMETERS = 32
"""Of more parameters no index is computed: it would take longer than many an attack."""

_FORESTS, _TREES, _LEAF = 20, 10, 5
_POINTS = 1_024
"""Base points of the Sobol indices: the forests are asked (d + 2) times as many."""

_BACKGROUND, _GRID = 128, 21
_LOW, _HIGH = 0.05, 0.95


class Influence(Strict):
    """How much of the variance of the failure probability a parameter explains, in uniform worlds.

    The indices are Sobol's (2001), of a model of the probability; each has an interval of 90 % over
    models of resampled worlds, which says how far the worlds determine it, not how good the model
    is.

    Attributes:
        first: The share that the parameter explains alone.
        total: The share in which it takes part.
    """

    parameter: str
    first: float
    first_interval: tuple[float, float]
    total: float
    total_interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class FailureModel:
    """Models of the probability that the agent fails, each fitted to resampled worlds."""

    forests: Sequence[Callable[[Mu | Floats], Floats]]
    dimension: int

    def curve(self, parameter: int) -> tuple[Floats, Floats]:
        """Return values of mu along a parameter, (g,), and the probability there, (3, g).

        The rows are the mean over uniform worlds, and the ends of its interval of 90 %.
        """
        values, background = np.linspace(-1.0, 1.0, _GRID), self._background(_BACKGROUND)
        points = np.repeat(background[None], _GRID, axis=0)
        points[:, :, parameter] = values[:, None]
        flat = points.reshape(-1, self.dimension)
        means = np.array([p(flat).reshape(_GRID, -1).mean(axis=1) for p in self.forests])
        return values, np.array([means.mean(axis=0), *np.quantile(means, (_LOW, _HIGH), axis=0)])

    def map(self, first: int, second: int) -> tuple[Floats, Floats]:
        """Return values along two parameters, (g,), and the mean probability there, (g, g).

        Rows run along the second parameter.
        """
        values, background = np.linspace(-1.0, 1.0, _GRID), self._background(_BACKGROUND // 4)
        points = np.tile(background, (_GRID, _GRID, 1, 1))
        points[:, :, :, first] = values[None, :, None]
        points[:, :, :, second] = values[:, None, None]
        flat = points.reshape(-1, self.dimension)
        mean = np.mean([p(flat) for p in self.forests], axis=0)
        return values, mean.reshape(_GRID, _GRID, -1).mean(axis=2)

    def influences(self, names: Sequence[str]) -> tuple[Influence, ...]:
        """Return the influence of each parameter, the greatest first."""
        means, low, high = self._shares
        influences = [
            Influence(
                parameter=name,
                first=float(means[0, i]),
                first_interval=(float(low[0, i]), float(high[0, i])),
                total=float(means[1, i]),
                total_interval=(float(low[1, i]), float(high[1, i])),
            )
            for i, name in enumerate(names)
        ]
        return tuple(sorted(influences, key=lambda influence: -influence.total))

    @cached_property
    def _shares(self) -> tuple[Floats, Floats, Floats]:
        """The first and the total indices, (2, d), and the ends of their intervals."""
        from scipy.stats import qmc, sobol_indices

        # one design for all forests: the interval is that of the worlds
        design = qmc.Sobol(2 * self.dimension, rng=np.random.default_rng(0)).random(_POINTS)
        a, b = np.split(2.0 * design - 1.0, 2, axis=1)
        mixed = np.repeat(a[None], self.dimension, axis=0)
        for i in range(self.dimension):
            mixed[i, :, i] = b[:, i]
        answers = {"f_A": self._ask(a), "f_B": self._ask(b)}
        answers["f_AB"] = np.moveaxis(
            self._ask(mixed.reshape(-1, self.dimension)).reshape(-1, *mixed.shape[:2]), 1, 0
        )
        indices = sobol_indices(func=answers, n=_POINTS)
        # (2, s, d): of each forest; a forest that says the same everywhere has none
        shares = np.array([indices.first_order, indices.total_order])
        # of one parameter or one forest SciPy drops the axis
        shares = shares.reshape(2, len(self.forests), self.dimension)
        shares = np.clip(np.nan_to_num(shares), 0.0, 1.0).swapaxes(0, 1)
        means = shares.mean(axis=0)
        low, high = np.quantile(shares, (_LOW, _HIGH), axis=0)
        return means, low, high

    def _ask(self, mu: Floats) -> Floats:
        return np.array([forest(mu) for forest in self.forests])

    def _background(self, count: int) -> Floats:
        from scipy.stats import qmc

        drawn: Floats = qmc.Sobol(self.dimension, rng=np.random.default_rng(1)).random(count)
        return 2.0 * drawn - 1.0


def fit_failures(mu: Mu, fooled: Bools) -> FailureModel | None:
    """Fit models of the failure probability to worlds, (n, d), and whether each fooled the agent.

    The worlds may be chosen in any way that looks at mu and earlier worlds alone. None where there
    are too few worlds, failures or others, or too many parameters. The last models are kept, for
    the result and the pictures of an attack need the same ones.
    """
    rarer = min(fooled.sum(), (~fooled).sum())
    if mu.shape[1] > MAX_PARAMETERS or len(mu) < MIN_WORLDS or rarer < MIN_KIND:
        return None
    return _fitted(np.ascontiguousarray(mu).tobytes(), mu.dtype.str, mu.shape, fooled.tobytes())


@lru_cache(maxsize=1)
def _fitted(worlds: bytes, kind: str, shape: tuple[int, int], fools: bytes) -> FailureModel:
    from sklearn.ensemble import ExtraTreesClassifier

    mu, fooled = np.frombuffer(worlds, kind).reshape(shape), np.frombuffer(fools, np.bool_)
    rng, forests = np.random.default_rng(0), []
    with single_threaded():
        for seed in range(_FORESTS):
            rows = rng.integers(len(mu), size=len(mu))
            if fooled[rows].all() or not fooled[rows].any():
                continue
            forest = ExtraTreesClassifier(
                _TREES, min_samples_leaf=_LEAF, max_features=None, random_state=seed
            )
            forests.append(_probability(forest.fit(mu[rows], fooled[rows])))
    return FailureModel(forests, mu.shape[1])


def _probability(forest: ExtraTreesClassifier) -> Callable[[Mu | Floats], Floats]:
    def predict(mu: Mu | Floats) -> Floats:
        with single_threaded():
            p: Floats = forest.predict_proba(mu)[:, 1]
        return p

    return predict
