"""`gaussian`, `gmm10`, `gmm50`: Gaussian mixtures on the induced set, the paper's baselines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sada_gym.adversaries.fitted import FittedAdversary
from sada_gym.adversaries.models.mixture import Mixture, fit_mixture
from sada_gym.adversaries.options import Options, option
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats


@dataclass(frozen=True)
class GaussianOptions(Options):
    """The options of `gaussian`, `gmm10`, `gmm50`: the largest size of S; 0 for all that fool."""

    induced_size: int = option(100, 0, 10**9)


class MixtureAdversary(FittedAdversary):
    """A learner whose distribution is a mixture, `_mixture`, which `fit` sets."""

    packages = ("scikit-learn",)

    _mixture: Mixture

    def draw(self, n: int) -> Floats:
        return self._mixture.sample(n, self.rng)


class Gaussian(MixtureAdversary):
    """A Gaussian with full covariance, fitted on the induced set of a uniform pool.

    All of the budget goes into Omega (Hamdi, Mueller, Ghanem 2020, "Baselines", Gaussian Mixture
    Model). Samples are truncated to the box; the authors' code clips them. The paper does not say
    how covariances are regularised; `fit_mixture` says how it is done here. See `GaussianOptions`.
    """

    name: ClassVar[str] = "gaussian"
    uniform_queries: ClassVar[bool] = True
    options_class = GaussianOptions
    components_share: ClassVar[float] = 0.0
    """The number of components, as a share of the points in the induced set; at least one."""

    options: GaussianOptions

    def fit(self, queries: Evaluations) -> None:
        chosen = self._select_fooling(queries, self.options.induced_size).chosen
        components = max(1, round(self.components_share * len(chosen)))
        self._mixture = fit_mixture(chosen, components, self.rng)


class GMM10(Gaussian):
    """Like `gaussian`, but a mixture with one Gaussian for every 10 points of the induced set."""

    name: ClassVar[str] = "gmm10"
    components_share: ClassVar[float] = 0.1


class GMM50(Gaussian):
    """Like `gaussian`, but a mixture with one Gaussian for every 2 points of the induced set."""

    name: ClassVar[str] = "gmm50"
    components_share: ClassVar[float] = 0.5
