"""`gaussian`, `gmm10`, `gmm50`: Gaussian mixtures on the induced set, the paper's baselines."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.adversaries.base import Query
from sada_gym.adversaries.learner import NONE_FOOLED, Arrays, Learner
from sada_gym.adversaries.mixture import Mixture, fit_mixture
from sada_gym.adversaries.omega import Omega, evaluate_uniform, induce
from sada_gym.errors import UserError


class MixtureLearner(Learner):
    """A learner whose distribution is a mixture, `_mixture`, which `_train` sets."""

    _mixture: Mixture

    def _draw(self, n: int) -> npt.NDArray[np.float64]:
        return self._mixture.sample(n, self.rng)

    def _arrays(self) -> Arrays:
        return self._mixture.to_arrays()

    def _restore(self, arrays: Arrays) -> None:
        self._mixture = Mixture.from_arrays(arrays)


class Gaussian(MixtureLearner):
    """A Gaussian with full covariance, fitted on the induced set of a uniform pool.

    All of the budget goes into Omega (Hamdi, Mueller, Ghanem 2020, "Baselines", Gaussian Mixture
    Model). Samples are truncated to the box where the authors' code clips them; covariances are
    regularised as `fit_mixture` says, on which the paper is silent.

    Args:
        dimension: d, the number of semantic parameters.
        seed: Fixes all randomness of training and sampling; None draws one.
        induced_size: s, the most points of the induced set; 0 for all that fool.

    Raises:
        ValueError: If the dimension or the induced size is bad.
    """

    name: ClassVar[str] = "gaussian"
    uniform_queries: ClassVar[bool] = True
    components_share: ClassVar[float] = 0.0
    """The number of components, as a share of the points in the induced set; at least one."""

    def __init__(self, dimension: int, *, seed: int | None = None, induced_size: int = 100) -> None:
        super().__init__(dimension, seed=seed)
        if type(induced_size) is not int or induced_size < 0:
            raise UserError(
                f"Expected induced_size to be an int of at least 0, got {induced_size!r}."
            )
        self.induced_size = induced_size

    @property
    def options(self) -> dict[str, Any]:
        """The keywords that make an equal adversary."""
        return {"induced_size": self.induced_size}

    def _train(self, oracle: Query) -> Omega:
        omega = evaluate_uniform(oracle.remaining, self.dimension, oracle, self.rng)
        induced = induce(omega, oracle.threshold, self.rng, size=self.induced_size or None)
        if induced.fallback:
            self.flags.append(NONE_FOOLED)
        components = max(1, round(self.components_share * len(induced.chosen)))
        self._mixture = fit_mixture(induced.chosen, components, self.rng)
        return omega


class GMM10(Gaussian):
    """A mixture with a tenth as many Gaussians as the induced set has points; else `gaussian`."""

    name: ClassVar[str] = "gmm10"
    components_share: ClassVar[float] = 0.1


class GMM50(Gaussian):
    """A mixture with half as many Gaussians as the induced set has points; else `gaussian`."""

    name: ClassVar[str] = "gmm50"
    components_share: ClassVar[float] = 0.5
