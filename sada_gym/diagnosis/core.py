"""Makes a diagnosis of known worlds and of fresh ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.arrays import Bools, Indices
from sada_gym.diagnosis.checking import Checked, Permits, Try, check
from sada_gym.diagnosis.find import Found, find_rules
from sada_gym.diagnosis.grouping import parts_of
from sada_gym.diagnosis.record import Diagnosis, Example, SumCondition, Weakness
from sada_gym.diagnosis.rules import draw, holds, volume
from sada_gym.diagnosis.wording import conditions, listed, thresholds
from sada_gym.evaluations import Evaluations
from sada_gym.measures.failure_regions import MIN_FAILURES, Condition, percent, too_few
from sada_gym.measures.groups import neighbourhoods, places
from sada_gym.parameters import ParameterSpace

_EXAMPLES = 5
_FEWEST_UNIFORM = 30
"""Without so many uniform worlds, fresh ones are spent to know the rate elsewhere."""

_FEWEST_SHARED = 20
_MOST_KNOWN = 20_000


def diagnose_worlds(
    space: ParameterSpace,
    known: Evaluations,
    threshold: float,
    uniform: Bools,
    *,
    evaluate: Try | None = None,
    fresh: int = 0,
    permits: Permits | None = None,
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
        permits: Which worlds can exist at all; None where all can.
        seed: Fixes the result.
    """
    kept = ~known.invalid
    known, uniform = known[kept], uniform[kept]
    count = len(known)
    fooled = known.fooled(threshold)
    failing = np.unique(known.mu[fooled] + np.float32(0.0), axis=0)
    if len(failing) < MIN_FAILURES:
        sentence = too_few(int(fooled.sum()), len(failing), "world")
        return Diagnosis(sentence=sentence, worlds=count, failures=len(failing))
    rng, spent = np.random.default_rng([seed, 1]), 0
    if evaluate is not None and fresh and uniform.sum() < _FEWEST_UNIFORM:
        mu = draw((), space, fresh // 2, rng)
        mu = mu if permits is None else mu[permits(mu)]
        hits, valid = evaluate(mu)
        spent = len(mu)
        drawn = Evaluations.unseeded(mu, np.where(hits, threshold, np.inf))[valid]
        known, uniform = known + drawn, np.append(uniform, np.ones(len(drawn), np.bool_))
        fooled = np.append(fooled, hits[valid])
    rows = _chosen(len(known), rng)
    found = find_rules(space, known.mu[rows], fooled[rows], uniform[rows], seed)
    rules = [conditions(space, rule) for rule in found.rules]
    rest = 0 if evaluate is None else fresh - spent
    checked = check(space, rules, found, rest, evaluate or _none, permits, rng)
    weaknesses = _weaknesses(space, known, fooled, uniform, found, rules, checked.rules)
    if checked.outside is not None:
        weaknesses = [
            weakness.model_copy(update={"outside": checked.outside}) for weakness in weaknesses
        ]
    explained = [holds(weakness.conditions, space, known.mu) for weakness in weaknesses]
    return Diagnosis(
        sentence=_sentence(weaknesses, len(failing), len(rules)),
        weaknesses=tuple(weaknesses),
        worlds=count,
        failures=len(failing),
        explained=_share(np.logical_or.reduce(explained), fooled, uniform) if explained else 0.0,
        fresh=spent + checked.fresh,
    )


def _none(_: object) -> tuple[Bools, Bools]:
    return np.zeros(0, np.bool_), np.zeros(0, np.bool_)


def _chosen(count: int, rng: np.random.Generator) -> Indices:
    """Choose at most so many worlds evenly: more say little more, and take long."""
    if count <= _MOST_KNOWN:
        return np.arange(count)
    return np.sort(rng.choice(count, _MOST_KNOWN, replace=False))


def _share(inside: Bools, fooled: Bools, uniform: Bools) -> float:
    even = fooled & uniform
    failing = even if even.sum() >= _FEWEST_SHARED else fooled
    return float(inside[failing].mean())


def _weaknesses(
    space: ParameterSpace,
    known: Evaluations,
    fooled: Bools,
    uniform: Bools,
    found: Found,
    rules: Sequence[Sequence[Condition | SumCondition]],
    standing: Sequence[Checked],
) -> list[Weakness]:
    """Describe the rules that stand; the one with the largest share of the failures comes first."""
    weaknesses = []
    for checked in standing:
        said = tuple(rules[checked.place])
        inside = holds(said, space, known.mu)
        mine = known[inside & fooled & (known.seed >= 0)]
        _, first = np.unique(mine.mu, axis=0, return_index=True)
        mine = mine[np.sort(first)]
        near = neighbourhoods(places(mine.mu, space), len(space)) if len(mine) else []
        weaknesses.append(
            Weakness(
                conditions=said,
                text=listed(said),
                volume=volume(said, space),
                share=_share(inside, fooled, uniform),
                failures=len(mine),
                distinct=len(parts_of(said, space, mine.mu)) if len(mine) else 0,
                inside=checked.inside,
                outside=None,
                thresholds=thresholds(found.rules[checked.place]),
                examples=_examples(space, mine, near),
            )
        )
    return sorted(weaknesses, key=lambda weakness: -weakness.share)


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


def _sentence(weaknesses: Sequence[Weakness], failures: int, tried: int) -> str:
    if not weaknesses:
        refused = " Fresh worlds refused what the known ones hinted at." if tried else ""
        return (
            f"Nowhere in particular: no few conditions hold the {failures:,} failures much more "
            f"often than other worlds.{refused}"
        )
    first = weaknesses[0]
    more = len(weaknesses) - 1
    others = {0: "", 1: " There is one more weakness."}.get(more, f" There are {more} more.")
    return f"Fails where {first.text}: {percent(first.share)} of the failures.{others}"
