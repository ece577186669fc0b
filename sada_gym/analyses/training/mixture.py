"""Draws the world of each episode: from sources of failures, uniformly, or as in ordinary use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.analyses.training.sources import as_source
from sada_gym.analyses.training.worlds import WorldSpace
from sada_gym.envs.checks import is_number
from sada_gym.errors import UserError, UserTypeError, check_keywords, check_known
from sada_gym.foundations.arrays import Floats32
from sada_gym.parameters import Mu

FAILURES, UNIFORM, NOMINAL = "failures", "uniform", "nominal"

_TRIED = 10_000
"""`GymnasiumApplication` refuses regions of less than a thousandth of the box."""


@dataclass(frozen=True, eq=False)
class DrawnWorld:
    """A world to train in: where it comes from, and mu, (d,); None is the environment as it is."""

    source: str
    mu: Floats32 | None


class WorldMixture:
    """A mixture of sources of worlds, each with its share of the episodes.

    Args:
        space: The worlds that the environment can make.
        source: A source as in `FailureCurriculum`, which gets the name `failures`; several sources
            by name; or None.
        shares: The share of episodes by the name of the source, also `uniform` and `nominal`. They
            sum to 1; names that are missing have 0. None gives half to the sources, in equal parts,
            and a quarter each to uniform and nominal worlds.

    Raises:
        UserError: If a source cannot be read or its worlds have other parameters, or the shares are
            not as described.
    """

    def __init__(
        self, space: WorldSpace, source: Any = None, shares: Mapping[str, float] | None = None
    ) -> None:
        self.space = space
        self._pools: dict[str, Mu] = {}
        named = {FAILURES: source} if source is not None else {}
        if isinstance(source, Mapping):
            check_keywords("source", source)
            named = dict(source)
        for name, given in named.items():
            self._pools[name] = self._pool(name, given)
        self._given = self._checked(shares, self._pools)

    def set_source(
        self, source: Any, name: str = FAILURES, shares: Mapping[str, float] | None = None
    ) -> None:
        """Replace a source, or add one; the next episodes draw from it.

        Raises:
            UserError: As the constructor does. Then nothing changes.
        """
        pools = {**self._pools, name: self._pool(name, source)}
        given = self._checked(self._given if shares is None else shares, pools)
        self._pools, self._given = pools, given

    @property
    def shares(self) -> dict[str, float]:
        """The shares above 0, by the name of the source."""
        if self._given is not None:
            return {name: share for name, share in self._given.items() if share > 0.0}
        rest = 0.25 if self._pools else 0.5
        each = 0.5 / max(1, len(self._pools))
        return {**dict.fromkeys(self._pools, each), UNIFORM: rest, NOMINAL: rest}

    def draw(self, rng: np.random.Generator) -> DrawnWorld:
        """Draw the world of one episode."""
        names, shares = zip(*self.shares.items(), strict=True)
        name = names[rng.choice(len(names), p=np.array(shares) / sum(shares))]
        if name == UNIFORM:
            return DrawnWorld(name, self._uniform(rng))
        if name == NOMINAL:
            density = self.space.density
            mu = self.space.nominal if density is None else density.sample(1, rng)[0]
            return DrawnWorld(name, mu)
        pool = self._pools[name]
        return DrawnWorld(name, pool[rng.integers(len(pool))])

    def _uniform(self, rng: np.random.Generator) -> Floats32:
        for _ in range(_TRIED):
            mu = rng.uniform(-1.0, 1.0, (1, len(self.space.parameters))).astype(np.float32)
            if self.space.permits(mu)[0]:
                drawn: Floats32 = mu[0]
                return drawn
        raise UserError("Expected a region of worlds that can exist, found none.")

    def _pool(self, name: str, source: Any) -> Mu:
        if not isinstance(name, str) or name in (UNIFORM, NOMINAL, ""):
            raise UserError(
                f"Expected a name of a source other than {UNIFORM!r} and {NOMINAL!r}, which need "
                f"none, got {name!r}."
            )
        pool = as_source(source).pool(self.space)
        pool = pool[self.space.permits(pool)]
        if not len(pool):
            raise UserError(
                f"Expected worlds that can exist from the source {name!r}, got none: feasible= "
                "allows none of them. Name another source."
            )
        return pool

    def _checked(
        self, shares: Mapping[str, float] | None, pools: Mapping[str, Mu]
    ) -> dict[str, float] | None:
        if shares is None:
            return None
        check_keywords("shares", shares)
        check_known("source of shares", shares, [*pools, UNIFORM, NOMINAL])
        for name, share in shares.items():
            if not is_number(share):
                raise UserTypeError(
                    f"Expected the share of {name!r} to be a number such as 0.5, got {share!r}."
                )
            if not 0.0 <= share <= 1.0:
                raise UserError(f"Expected the share of {name!r} from 0 to 1, got {share}.")
        if abs(sum(shares.values()) - 1.0) > 1e-6:
            raise UserError(
                f"Expected shares that sum to 1, got {dict(shares)}, which sum to "
                f"{sum(shares.values()):g}. Change one of them."
            )
        return {name: float(share) for name, share in shares.items()}
