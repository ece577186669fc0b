"""Checks rules by fresh uniform worlds, inside and outside: which of them stand?"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sada_gym.arrays import Bools
from sada_gym.diagnosis.find import Found
from sada_gym.diagnosis.rules import draw, holds
from sada_gym.measures.failure_regions import Condition
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Mu, ParameterSpace

MOST_RULES = 5

_LEAST_EVIDENCE = 8.0
"""The log-likelihood by known and fresh worlds together, less all costs, that a rule needs."""

_LEAST_LEAD = 0.4
"""Inside the rate exceeds that outside by at least this share of what the known worlds said."""

_OUTSIDE, _MOST_INSIDE, _MOST_OUTSIDE = 0.3, 40, 60
_ROUNDS = 100

Try = Callable[[Mu], tuple[Bools, Bools]]
"""Evaluates fresh worlds, (n, d): which fooled, and which are valid, both (n,)."""

Permits = Callable[[Mu], Bools]


@dataclass(frozen=True)
class Checked:
    """A rule that stands, by its place, and its fooling rate in fresh worlds, if there were any."""

    place: int
    inside: Rate | None


@dataclass(frozen=True)
class Check:
    """The rules that stand, the fooling rate outside all, and how many worlds it took."""

    rules: tuple[Checked, ...]
    outside: Rate | None
    fresh: int


def check(
    space: ParameterSpace,
    rules: Sequence[Sequence[Condition]],
    found: Found,
    fresh: int,
    evaluate: Try,
    permits: Permits | None,
    rng: np.random.Generator,
) -> Check:
    """Spend at most so many fresh worlds on rules, as their conditions."""
    parts = _parts(space, rules, fresh, permits, rng)
    mu = np.concatenate(parts)
    if len(mu):
        fooled, valid = evaluate(mu)
    else:
        fooled = valid = np.zeros(0, np.bool_)
    ends = np.cumsum([len(part) for part in parts])[:-1]
    rates = [
        Rate.of(int(hits[kept].sum()), int(kept.sum())) if kept.any() else None
        for hits, kept in zip(np.split(fooled, ends), np.split(valid, ends), strict=True)
    ]
    *inside, outside = rates
    standing = [
        Checked(place, rate)
        for place, rate in enumerate(inside)
        if _stands(found, place, rate, outside)
    ]
    standing.sort(key=lambda one: -found.gains[one.place])
    return Check(tuple(standing[:MOST_RULES]), outside, len(mu))


def _parts(
    space: ParameterSpace,
    rules: Sequence[Sequence[Condition]],
    fresh: int,
    permits: Permits | None,
    rng: np.random.Generator,
) -> list[Mu]:
    """Draw worlds for each rule, and some outside all rules."""
    if not rules or not fresh:
        return [np.zeros((0, len(space)), np.float32)] * (len(rules) + 1)
    outside = min(max(round(_OUTSIDE * fresh), 1), _MOST_OUTSIDE)
    each = min((fresh - outside) // len(rules), _MOST_INSIDE)

    def within(rule: Sequence[Condition]) -> Callable[[int], Mu]:
        return lambda n: draw(rule, space, n, rng)

    def elsewhere(n: int) -> Mu:
        mu = draw((), space, n, rng)
        inside = [holds(rule, space, mu) for rule in rules]
        return np.asarray(mu[~np.logical_or.reduce(inside)], np.float32)

    parts = [_permitted(within(rule), each, permits) for rule in rules]
    return [*parts, _permitted(elsewhere, outside, permits)]


def _permitted(sample: Callable[[int], Mu], count: int, permits: Permits | None) -> Mu:
    """Draw worlds that can exist at all; fewer than `count` where they are rare."""
    kept = [sample(0)]
    for _ in range(_ROUNDS):
        missing = count - sum(map(len, kept))
        if not missing:
            break
        mu = sample(missing)
        kept.append(mu if permits is None or not len(mu) else mu[permits(mu)])
    return np.concatenate(kept)


def _stands(found: Found, place: int, inside: Rate | None, outside: Rate | None) -> bool:
    evidence, rate = found.gains[place], found.rates[place]
    low = found.elsewhere
    if inside is None:
        return evidence >= 2.0 * _LEAST_EVIDENCE
    misses = inside.samples - inside.fooled
    evidence += inside.fooled * math.log(rate / low)
    evidence += misses * math.log((1.0 - rate) / (1.0 - low))
    beyond = low if outside is None else outside.rate
    return evidence >= _LEAST_EVIDENCE and inside.rate - beyond >= _LEAST_LEAD * (rate - low)
