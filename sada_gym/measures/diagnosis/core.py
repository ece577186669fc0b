"""Makes a diagnosis of known worlds and of fresh ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Indices
from sada_gym.foundations.figures import percent
from sada_gym.measures.diagnosis.checking import MOST_RULES, Checker, Drawn, Try, stands
from sada_gym.measures.diagnosis.find import find_rules
from sada_gym.measures.diagnosis.grouping import parts_of
from sada_gym.measures.diagnosis.record import (
    Condition,
    Diagnosis,
    Example,
    SumCondition,
    Weakness,
)
from sada_gym.measures.diagnosis.rules import draw, holds, volume
from sada_gym.measures.diagnosis.summary import rate_text
from sada_gym.measures.diagnosis.thresholds import Rule
from sada_gym.measures.diagnosis.wording import conditions, listed, thresholds
from sada_gym.measures.groups import neighbourhoods, places
from sada_gym.measures.rates import Rate
from sada_gym.parameters import ParameterSpace, Permits, all_can_exist

_EXAMPLES = 5
_FEWEST_UNIFORM = 30
"""Without so many uniform worlds, fresh ones are spent to know the rate elsewhere."""

_FEWEST_SHARED = 20
_MOST_KNOWN = 20_000
_NEARLY_ALL = 0.9


MIN_FAILURES = 10
"""The least number of different failures of which anything is said."""


def diagnose_worlds(
    space: ParameterSpace,
    known: Evaluations,
    threshold: float,
    uniform: Bools,
    *,
    evaluate: Try | None = None,
    fresh: int = 0,
    enough: bool = False,
    permits: Permits = all_can_exist,
    seed: int = 0,
) -> Diagnosis:
    """Find the weaknesses that known worlds show, and check them by fresh ones.

    Args:
        space: The parameters of the worlds.
        known: Evaluations, chosen in any way that looks at mu and earlier worlds alone.
        threshold: Epsilon.
        uniform: Which of these were drawn evenly from the space, (n,).
        evaluate: Evaluates fresh worlds; None where none can be.
        fresh: The most fresh worlds.
        enough: Whether there may be more, where so few cannot confirm each rule.
        permits: Which worlds can exist at all.
        seed: Fixes the result.
    """
    rng = np.random.default_rng([seed, 1])
    possible = known[uniform & permits(known.mu)]
    everywhere = np.zeros(len(possible), np.intp)
    drawn = Drawn(possible.mu, possible.fooled(threshold), ~possible.invalid, everywhere)
    kept = ~known.invalid
    known, uniform = known[kept], uniform[kept]
    count = len(known)
    fooled = known.fooled(threshold)
    failing = np.unique(known.mu[fooled] + np.float32(0.0), axis=0)
    if len(failing) < MIN_FAILURES:
        sentence = _too_few(int(fooled.sum()), len(failing))
        return Diagnosis(sentence=sentence, worlds=count, failures=len(failing))
    spent = 0
    if evaluate is not None and fresh and uniform.sum() < _FEWEST_UNIFORM:
        mu = draw((), space, fresh // 2, rng)
        mu = mu[permits(mu)]
        hits, valid = evaluate(mu)
        spent = len(mu)
        drawn += Drawn(mu, hits, valid, np.zeros(spent, np.intp))
        more = Evaluations.unseeded(mu, np.where(hits, threshold, np.inf))[valid]
        known, uniform = known + more, np.append(uniform, np.ones(len(more), np.bool_))
        fooled = np.append(fooled, hits[valid])
    rows = _chosen(len(known), rng)
    found = find_rules(space, known.mu[rows], fooled[rows], uniform[rows], seed)
    rules = [conditions(space, rule) for rule in found.rules]
    checker = Checker(space, rules, permits, rng)
    own = checker.spend(evaluate, fresh - spent, enough=enough)
    drawn += own
    outside = own.at(1)
    standing = [i for i in range(len(rules)) if stands(found, i, own.at(i + 2), outside)]
    standing = sorted(standing, key=lambda i: -found.gains[i])[:MOST_RULES]
    inside = {i: holds(rules[i], space, drawn.mu) for i in standing}
    elsewhere = ~np.logical_or.reduce([np.zeros(len(drawn.mu), np.bool_), *inside.values()])
    is_checked = len(own.mu) > 0
    weaknesses = [
        _weakness(space, known, fooled, uniform, rules[i], found.rules[i]).model_copy(
            update={
                "inside": checker.rate(drawn, inside[i]) if is_checked else None,
                "outside": checker.rate(drawn, elsewhere) if is_checked else None,
                "fresh": (len(own.at(i + 2)), len(outside)),
            }
        )
        for i in standing
    ]
    weaknesses.sort(key=lambda one: (not one.is_checked, -one.share))
    explained = [holds(weakness.conditions, space, known.mu) for weakness in weaknesses]
    anywhere = checker.rate(drawn, np.ones(len(drawn.mu), np.bool_))
    return Diagnosis(
        sentence=_sentence(weaknesses, len(failing), len(rules), anywhere),
        weaknesses=tuple(weaknesses),
        worlds=count,
        failures=len(failing),
        explained=_share(np.logical_or.reduce(explained), fooled, uniform) if explained else 0.0,
        fresh=spent + len(own.mu),
    )


def _too_few(failures: int, different: int) -> str:
    """Say that so many failures, so many of them different, say nothing."""
    if not failures:
        return "No world fooled the agent."
    if different < failures:
        worlds = "one world" if different == 1 else f"{different} different worlds"
        return f"The {failures:,} failures are {worlds}, too few to say where the agent fails."
    count = "Only one world" if failures == 1 else f"Only {failures} worlds"
    return f"{count} fooled the agent, too few to say where it fails."


def _chosen(count: int, rng: np.random.Generator) -> Indices:
    """Choose at most so many worlds evenly: more say little more, and take long."""
    if count <= _MOST_KNOWN:
        return np.arange(count)
    return np.sort(rng.choice(count, _MOST_KNOWN, replace=False))


def _share(inside: Bools, fooled: Bools, uniform: Bools) -> float:
    even = fooled & uniform
    failing = even if even.sum() >= _FEWEST_SHARED else fooled
    return float(inside[failing].mean())


def _weakness(
    space: ParameterSpace,
    known: Evaluations,
    fooled: Bools,
    uniform: Bools,
    said: Sequence[Condition | SumCondition],
    rule: Rule,
) -> Weakness:
    """Describe a rule that stands, but for its rates."""
    inside = holds(said, space, known.mu)
    mine = known[inside & fooled & (known.seed >= 0)]
    _, first = np.unique(mine.mu, axis=0, return_index=True)
    mine = mine[np.sort(first)]
    near = neighbourhoods(places(mine.mu, space), len(space)) if len(mine) else []
    return Weakness(
        conditions=tuple(said),
        text=listed(said),
        volume=volume(said, space),
        share=_share(inside, fooled, uniform),
        failures=len(mine),
        distinct=len(parts_of(said, space, mine.mu)) if len(mine) else 0,
        inside=None,
        outside=None,
        thresholds=thresholds(space, rule),
        examples=_examples(space, mine, near),
    )


def _examples(
    space: ParameterSpace, failures: Evaluations, groups: Sequence[Indices]
) -> tuple[Example, ...]:
    """Choose failures of each group in turn, the middle ones first."""
    turns = [rows[i] for i in range(_EXAMPLES) for rows in groups if i < len(rows)]
    return tuple(
        Example(
            mu=tuple(failures.mu[row].tolist()),
            seed=int(failures.seed[row]),
            score=float(failures.score[row]),
            parameters=space.describe(failures.mu[row]),
        )
        for row in turns[:_EXAMPLES]
    )


def _sentence(
    weaknesses: Sequence[Weakness], failures: int, tried: int, anywhere: Rate | None
) -> str:
    if not weaknesses:
        refused = " Fresh worlds did not confirm what the known ones suggest." if tried else ""
        if anywhere is not None and anywhere.rate >= _NEARLY_ALL:
            every = "Every" if anywhere.fooled == anywhere.samples else "Nearly every"
            return (
                f"{every} world fails: {rate_text(anywhere)} of uniform worlds fool the agent. "
                "Look for where it succeeds."
            )
        return (
            f"Nowhere in particular: no rule of a few conditions holds for many more of the "
            f"{failures:,} failures than of other worlds.{refused}"
        )
    first = weaknesses[0]
    more = len(weaknesses) - 1
    others = {0: "", 1: " There is one more weakness."}.get(more, f" There are {more} more.")
    fails = "Fails where" if first.is_checked else "Perhaps fails where"
    unsure = "" if first.is_checked else ", not yet confirmed"
    share = percent(first.share)
    return f"{fails} {first.text}{unsure}: {share} of the failures.{others}"
