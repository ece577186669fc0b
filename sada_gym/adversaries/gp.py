"""`gp`: Gaussian process regression on all of Omega (a baseline of the paper)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sada_gym.adversaries.fitted import Arrays, validate_array
from sada_gym.adversaries.models.exact_gp import Kernel, fit_kernel, fit_weights, predict_mean
from sada_gym.adversaries.selection import Selection
from sada_gym.errors import UserError
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import AnyFloats, Floats

MAX_POINTS = 20_000
"""The most points that the process is fitted to: the paper's N. Memory grows with its square."""

CONSTANT = "all scores of Omega are equal: samples are uniform"


class GP(Selection):
    """A Gaussian process regression of the score; samples are random mu of the lowest mean.

    A baseline of Hamdi, Mueller, Ghanem 2020, section "Testing, Evaluation, and Baselines", with an
    exponential kernel. The length-scales, signal and noise maximise the marginal likelihood on a
    random subset of Omega; then the exact process is fitted to all of it. See `Selection` for how
    samples are chosen, and `SelectionOptions` for the options.
    """

    name: ClassVar[str] = "gp"
    packages = ()

    def fit(self, queries: Evaluations) -> None:
        if len(queries) > MAX_POINTS:
            self.flags.append(f"fitted to the first {MAX_POINTS} points of Omega's {len(queries)}")
        # Omega is in random order: its first points are a random subset
        x = queries.mu[:MAX_POINTS].astype(np.float64)
        score = queries.score[:MAX_POINTS]
        self._mean, scale = float(score.mean()), float(score.std())
        if np.ptp(score) == 0.0:  # rounding may leave their deviation above 0
            self.flags.append(CONSTANT)
            self._kernel = Kernel(np.ones(self.dimension), 1.0, 1.0)
            self._weights = np.zeros(len(x))
            return
        y = (score - self._mean) / scale
        self._kernel = fit_kernel(x[: self.options.subset], y[: self.options.subset])
        self._weights = scale * fit_weights(self._kernel, x, y)

    def _predict(self, mu: Floats) -> AnyFloats:
        x = self.queries.mu[: len(self._weights)].astype(np.float64)
        return self._mean + predict_mean(self._kernel, x, self._weights, mu)

    def arrays(self) -> Arrays:
        return {
            "mean": np.array(self._mean),
            "weights": self._weights,
            "length_scales": self._kernel.length_scales,
            "signal": np.array(self._kernel.signal),
            "noise": np.array(self._kernel.noise),
        }

    def restore(self, arrays: Arrays) -> None:
        points = min(len(self.queries), MAX_POINTS)
        self._mean = float(validate_array(arrays, "mean"))
        self._weights = validate_array(arrays, "weights", points)
        scales = validate_array(arrays, "length_scales", self.dimension)
        signal, noise = (float(validate_array(arrays, name)) for name in ("signal", "noise"))
        if min(*scales, signal, noise) <= 0.0:
            raise UserError("a length-scale, the signal or the noise is not above 0")
        self._kernel = Kernel(scales, signal, noise)
