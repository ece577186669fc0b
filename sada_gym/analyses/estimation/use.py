"""Ordinary use as points z: standard normal where parameters are independent, or else whitened."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import expit

from sada_gym.adversaries.query_pool import draw_permitted
from sada_gym.analyses.estimation.table import TableDensity
from sada_gym.densities import WorldDensity
from sada_gym.errors import UserError, UserTypeError, explained
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.parameters import Mu, ParameterSpace, Permits, all_can_exist

_COUNTED, _LEAST = 100_000, 1e-3
_COMPARED, _TOLERANCE = 10_000, 0.02
_EXPECTED = (
    "Expected density to have rvs(size, random_state) and logpdf(x), as frozen distributions of "
    "scipy.stats have"
)


class IndependentUse:
    """Ordinary use where parameters are independent: z is standard normal, and gives mu.

    Worlds that cannot exist are left out.
    """

    def __init__(self, density: WorldDensity, permits: Permits, rng: np.random.Generator) -> None:
        self.dimension, self.held, self.data = len(density.space), density.held, density.data
        self._density, self._permits = density, permits
        self._share = 1.0
        if permits is not all_can_exist:
            self._share = _checked_share(
                permits(self.mu(rng.normal(size=(_COUNTED, self.dimension))))
            )

    def mu(self, z: Floats) -> Mu:
        """Return the worlds at points, (n, d)."""
        return self._density.from_normal(z)

    def points(self, mu: Mu) -> Floats:
        """Return points that stand for worlds, (n, d), maybe infinite ones."""
        return self._density.to_normal(mu)

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw points, (count, d)."""
        return _permitted(
            lambda n: rng.normal(size=(n, self.dimension)),
            count,
            lambda z: self._permits(self.mu(z)),
        )

    def log_density(self, z: Floats) -> Floats:
        """Return the logarithm of the density at points, (n, d): (n,), maybe -inf."""
        logs = -0.5 * ((z**2).sum(axis=1) + self.dimension * np.log(2.0 * np.pi))
        if self._permits is not all_can_exist:
            logs = np.where(self._permits(self.mu(z)), logs - np.log(self._share), -np.inf)
        return np.asarray(logs)


class JointUse:
    """Ordinary use by a joint density of physical values: z is without mean and correlation.

    Values outside the ranges, and worlds that cannot exist, are left out.
    """

    def __init__(
        self, space: ParameterSpace, density: Any, permits: Permits, rng: np.random.Generator
    ) -> None:
        if not all(callable(getattr(density, name, None)) for name in ("rvs", "logpdf")):
            raise UserTypeError(f"{_EXPECTED}, got {density!r}.")
        self.dimension, self._space = len(space), space
        self._density, self._permits = density, permits
        self.table = density if isinstance(density, TableDensity) else None
        told = {
            name: getattr(density, name, None) for name in ("mean", "cov", "loc", "shape", "df")
        }
        numbers = {
            k: np.asarray(v).tolist() for k, v in told.items() if np.asarray(v).dtype != object
        }
        joint = {"joint": {"kind": type(density).__name__, **numbers}}
        self.data: dict[str, Any] = joint if self.table is None else self.table.data
        drawn = self._values(_COUNTED, rng)
        inside = self._inside(drawn)
        share = _checked_share(inside)
        self.held = share * float(getattr(density, "held", 1.0))
        kept = drawn[inside]
        self._mean = kept.mean(axis=0)
        covariance = np.atleast_2d(np.cov(kept, rowvar=False))
        tiny = np.maximum(1e-9 * np.diag(covariance), 1e-300)
        self._root = np.linalg.cholesky(covariance + np.diag(tiny))
        self._shift = float(np.log(np.diag(self._root)).sum() - np.log(share))
        if self.table is None:
            self._check(self._whitened(kept[:_COMPARED]))

    def mu(self, z: Floats) -> Mu:
        """Return the worlds at points, (n, d)."""
        normalised: Mu = np.clip(self._space.normalised(self._physical(z)), -1.0, 1.0)
        return normalised

    def points(self, mu: Mu) -> Floats:
        """Return points that stand for worlds, (n, d)."""
        return self._whitened(self._space.physical(mu))

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw points, (count, d)."""
        return self._whitened(_permitted(lambda n: self._values(n, rng), count, self._inside))

    def log_density(self, z: Floats) -> Floats:
        """Return the logarithm of the density at points, (n, d): (n,), maybe -inf."""
        values = self._physical(z)
        inside = self._inside(values)
        logs = np.full(len(z), -np.inf)
        if inside.any():
            with explained(_EXPECTED):
                given = np.asarray(self._density.logpdf(values[inside]), np.float64)
            if given.size != inside.sum():
                raise UserError(
                    f"Expected density.logpdf of {inside.sum()} worlds to have shape "
                    f"({inside.sum()},), got {given.shape}. Return a number for each row."
                )
            logs[inside] = np.nan_to_num(given.ravel(), nan=-np.inf) + self._shift
        return logs

    def _check(self, drawn: Floats) -> None:
        """Raise a UserError if rvs drew points, (n, d), that don't have the density of logpdf.

        With draws of a known density q beside these of density p, p / (p + q) among the draws of q
        has the mean of q / (p + q) among those of p (Bennett 1976). Both lie in 0 to 1.
        """
        normal = np.random.default_rng(0).normal(size=drawn.shape)
        constant = 0.5 * self.dimension * np.log(2.0 * np.pi)
        ratio, inverse = (
            sign * (self.log_density(z) + 0.5 * (z**2).sum(axis=1) + constant)
            for sign, z in ((1.0, normal), (-1.0, drawn))
        )
        shares = np.stack([expit(ratio), expit(inverse)])
        error = np.sqrt(shares.var(axis=1).sum() / len(drawn))
        if abs(np.subtract(*shares.mean(axis=1))) > _TOLERANCE + 5.0 * error:
            raise UserError(
                "Expected density.logpdf to be the logarithm of the density that density.rvs "
                "draws from, with an integral of 1, got another, whose integral is about "
                f"{np.exp(ratio.clip(max=700.0)).mean():.2g}. Normalise it, and give both the same "
                "parameters."
            )

    def _physical(self, z: Floats) -> Floats:
        return np.asarray(self._mean + z @ self._root.T)

    def _whitened(self, values: Floats) -> Floats:
        return np.asarray(np.linalg.solve(self._root, (values - self._mean).T).T)

    def _values(self, count: int, rng: np.random.Generator) -> Floats:
        with explained(_EXPECTED):
            drawn = np.asarray(self._density.rvs(size=count, random_state=rng), np.float64)
        if drawn.size != count * self.dimension or not np.isfinite(drawn).all():
            raise UserError(
                f"Expected {count} finite draws of {self.dimension} parameters from density.rvs, "
                f"got shape {drawn.shape}. Order the values as the parameters: "
                f"{', '.join(self._space.names)}."
            )
        return drawn.reshape(count, self.dimension)

    def _inside(self, values: Floats) -> Bools:
        mu = self._space.normalised(values)
        inside = np.asarray((np.abs(mu) <= 1.0).all(axis=1))
        if self._permits is not all_can_exist and inside.any():
            inside[inside] = self._permits(mu[inside])
        return inside


def _checked_share(inside: Bools) -> float:
    share = float(inside.mean())
    if share < _LEAST:
        raise UserError(
            f"Expected a thousandth at least of the density in the ranges and the feasible region, "
            f"got {share:.2g}. Widen the ranges."
        )
    return share


def _permitted(draw: Any, count: int, permits: Any) -> Floats:
    return np.asarray(draw_permitted(draw, count, permits), np.float64) if count else draw(0)
