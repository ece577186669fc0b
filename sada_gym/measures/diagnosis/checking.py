"""Checks rules by fresh worlds: which of them stand, and how often do worlds fool in them?"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from sada_gym.foundations.arrays import Bools, Floats, Indices
from sada_gym.measures.diagnosis.find import Found
from sada_gym.measures.diagnosis.record import LEAST_FRESH, Condition
from sada_gym.measures.diagnosis.rules import draw, holds, volume
from sada_gym.measures.rates import Rate, weighted_rate
from sada_gym.parameters import Mu, ParameterSpace, Permits

MOST_RULES = 5

_LEAST_EVIDENCE = 8.0
"""The log-likelihood by known and fresh worlds together, less all costs, that a rule needs."""

_LEAST_LEAD = 0.4
"""Inside the rate exceeds that outside by at least this share of what the known worlds said."""

_OUTSIDE, _MOST_INSIDE, _MOST_OUTSIDE = 0.3, 40, 60
_FITTED = 0.5
"""A world to which the rules were fitted counts so much in the width of an interval."""

_ROUNDS, _REPLACED = 100, 5
_DRAWS = 2**13

Try = Callable[[Mu], tuple[Bools, Bools]]
"""Evaluates fresh worlds, (n, d): which fooled, and which are valid, both (n,)."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Worlds that were drawn evenly from parts of a space.

    Attributes:
        mu: (n, d).
        fooled: Which fooled, (n,).
        valid: Which did not break, (n,).
        part: The part of each, (n,): 0 is the whole space, 1 is outside all rules, then each rule.
    """

    mu: Mu
    fooled: Bools
    valid: Bools
    part: Indices

    def __add__(self, other: Drawn) -> Drawn:
        """Join worlds."""
        names = [field.name for field in fields(self)]
        return Drawn(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in names))

    def at(self, part: int) -> Bools:
        """Return which of the valid worlds of a part fooled."""
        fooled: Bools = self.fooled[self.valid & (self.part == part)]
        return fooled


@dataclass(frozen=True, eq=False)
class Checker:
    """Evaluates fresh worlds for rules, and measures by all worlds whose density is known."""

    space: ParameterSpace
    rules: Sequence[Sequence[Condition]]
    permits: Permits
    rng: np.random.Generator

    def spend(self, evaluate: Try | None, fresh: int, *, enough: bool) -> Drawn:
        """Evaluate fresh worlds outside all rules and in each, in the first rules first.

        With `enough` there are more than `fresh` where so few could not confirm each rule.
        """
        count, parts = len(self.rules), len(self.rules) + 2
        none = np.zeros(0, np.bool_)
        done = Drawn(np.zeros((0, len(self.space)), np.float32), none, none, none.astype(np.intp))
        if not count or evaluate is None:
            return done
        fresh = max(fresh, LEAST_FRESH * (count + 1)) if enough else fresh
        outside = min(round(_OUTSIDE * fresh), _MOST_OUTSIDE, fresh - LEAST_FRESH * count)
        outside = max(outside, LEAST_FRESH)
        each = min(max((fresh - outside) // count, LEAST_FRESH), _MOST_INSIDE)
        wanted = _at_most(np.array([0, outside, *[each] * count]), fresh)
        for _ in range(1 + _REPLACED):  # worlds that broke are replaced
            missing = np.array([n - len(done.at(part)) for part, n in enumerate(wanted)])
            missing = missing if enough else _at_most(missing, fresh - len(done.mu))
            drawn = [self._draw(part, int(n)) for part, n in enumerate(missing)]
            mu = np.concatenate(drawn)
            if not len(mu):
                break
            part = np.repeat(np.arange(parts), list(map(len, drawn)))
            done += (new := Drawn(mu, *evaluate(mu), part))
            if not new.valid.any():
                break
        return done

    def rate(self, drawn: Drawn, region: Bools) -> Rate | None:
        """Measure how often worlds fool in a region, (n,) of those drawn: each by its weight."""
        rows = region & drawn.valid
        if not rows.any():
            return None
        fooled, parts = drawn.fooled[rows], self._parts(drawn.mu[rows])
        density = np.bincount(drawn.part, minlength=len(parts)) / self._shares @ parts
        trust = float(np.where(drawn.part[rows], 1.0, _FITTED).mean())
        found = weighted_rate(fooled, -np.log(density), trust=trust)
        assert found is not None
        return Rate(
            fooled=int(fooled.sum()),
            samples=len(fooled),
            rate=found.rate,
            interval_95=(found.low, found.high),
        )

    @cached_property
    def _shares(self) -> Floats:
        """The share of the worlds that can exist in each part, (p,)."""
        rng = np.random.default_rng(0)

        def possible(rule: Sequence[Condition]) -> Mu:
            mu = draw(rule, self.space, _DRAWS, rng)
            return np.asarray(mu[self.permits(mu)], np.float32)

        anywhere = possible(())
        inside = [volume(rule, self.space) * len(possible(rule)) for rule in self.rules]
        outside = self._parts(anywhere)[1].sum()
        return np.maximum([len(anywhere), outside, *inside], 1e-9) / max(len(anywhere), 1)

    def _parts(self, mu: Mu) -> Bools:
        """Return which worlds, (n, d), lie in each part, (p, n)."""
        inside = [holds(rule, self.space, mu) for rule in self.rules]
        everywhere = np.ones(len(mu), np.bool_)
        return np.array([everywhere, ~np.logical_or.reduce([~everywhere, *inside]), *inside])

    def _draw(self, part: int, count: int) -> Mu:
        """Draw worlds of a part that can exist; fewer than `count` where they are rare."""
        rule = self.rules[part - 2] if part > 1 else ()
        kept = [np.zeros((0, len(self.space)), np.float32)]
        for _ in range(_ROUNDS):
            missing = count - sum(map(len, kept))
            if missing <= 0:
                break
            mu = draw(rule, self.space, missing, self.rng)
            mu = mu[self._parts(mu)[part]]
            kept.append(mu[self.permits(mu)] if len(mu) else mu)
        return np.concatenate(kept)


def _at_most(counts: Indices, most: int) -> Indices:
    """Return counts that add up to no more, the first ones as they are."""
    return np.diff(np.minimum(np.cumsum(counts), most), prepend=0)


def stands(found: Found, place: int, inside: Bools, outside: Bools) -> bool:
    """Say whether a rule stands, by known worlds and by fresh ones inside and outside all rules."""
    evidence, rate = found.gains[place], found.rates[place]
    low = found.elsewhere
    if not len(inside):
        return evidence >= 2.0 * _LEAST_EVIDENCE
    evidence += float(inside.sum()) * math.log(rate / low)
    evidence += float((~inside).sum()) * math.log((1.0 - rate) / (1.0 - low))
    beyond = float(outside.mean()) if len(outside) else low
    return evidence >= _LEAST_EVIDENCE and inside.mean() - beyond >= _LEAST_LEAD * (rate - low)
