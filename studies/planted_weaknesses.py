"""Planted weaknesses: how many does a diagnosis find, and how much of what it names is false?"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym.analyses.diagnose import default_fresh
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools, Floats
from sada_gym.measures.diagnosis.core import diagnose_worlds
from sada_gym.measures.diagnosis.grouping import grouped
from sada_gym.measures.diagnosis.record import Diagnosis
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.measures.rates import Rate, wilson_interval
from sada_gym.parameters import Mu
from studies.planted_methods import Named, by_prim, by_tree
from studies.planted_queries import (
    ADVERSARIES,
    LEARNING,
    QUERIES,
    SAMPLES,
    Known,
    ask,
    attack_for_real,
)
from studies.planted_settings import DIMENSIONS, KINDS, TESTED, THRESHOLD, Setting, plant

OURS = "sada-gym"
OTHERS = {"PRIM": by_prim, "decision tree": by_tree}


def diagnosed(
    setting: Setting, known: Known, rng: np.random.Generator, queries: int = QUERIES
) -> Diagnosis:
    """Diagnose as `sada-gym diagnose` does."""
    mu = (2.0 * known.shares - 1.0).astype(np.float32)

    def evaluate(mu: Mu) -> tuple[Bools, Bools]:
        fooled = rng.random(len(mu)) < setting.rates((mu.astype(np.float64) + 1.0) / 2.0)
        return fooled, np.ones(len(mu), np.bool_)

    return diagnose_worlds(
        setting.space,
        Evaluations(mu, 1.0 - known.fooled, np.arange(len(mu))),
        THRESHOLD,
        known.uniform,
        evaluate=evaluate,
        fresh=default_fresh(queries),
        enough=True,
        seed=setting.seed,
    )


def by_diagnosis(setting: Setting, diagnosis: Diagnosis) -> Named:
    """Name the weaknesses of a diagnosis that are confirmed."""
    return [
        lambda shares, one=one: holds(one.conditions, setting.space, 2.0 * shares - 1.0)
        for one in diagnosis.weaknesses
        if one.is_checked
    ]


def held(setting: Setting, diagnosis: Diagnosis) -> dict[str, list[bool]]:
    """Say whether the intervals of the rates inside and elsewhere hold the true rates."""
    shares = np.random.default_rng([setting.seed, 51]).random((TESTED, len(setting.space)))
    rates, named = setting.rates(shares), diagnosis.weaknesses
    inside = [holds(one.conditions, setting.space, 2.0 * shares - 1.0) for one in named]
    outside = ~np.logical_or.reduce([np.zeros(TESTED, np.bool_), *inside])
    return {
        "inside": [
            _holds(one.inside, rates[rows]) for one, rows in zip(named, inside, strict=True)
        ],
        "outside": [_holds(one.outside, rates[outside]) for one in named[:1]],
    }


def _holds(rate: Rate | None, true: Floats) -> bool:
    return rate is not None and bool(rate.interval_95[0] <= true.mean() <= rate.interval_95[1])


def distinct_failures(setting: Setting, known: Known, diagnosis: Diagnosis) -> int:
    """Count the groups of the failures among the samples; those in no weakness where all are."""
    mu = (2.0 * known.shares[-SAMPLES:] - 1.0).astype(np.float32)
    groups = grouped(diagnosis, setting.space, mu[known.fooled[-SAMPLES:]])
    return sum(group.weakness != 0 for group in groups) or len(groups)


def judge(setting: Setting, named: Named) -> dict[str, list[Any]]:
    """Measure what is named by uniform worlds.

    Of each planted weakness: the greatest intersection over union with a rule, and that with all
    rules together most of whose volume lies in it. Of each rule: the share of its volume in any
    planted weakness, and its greatest intersection over union with one.
    """
    shares = np.random.default_rng([setting.seed, 51]).random((TESTED, len(setting.space)))
    planted = [weakness.contains(shares) for weakness in setting.planted]
    rules = [rule(shares) for rule in named]
    either = np.logical_or.reduce(planted)
    mine = [
        np.logical_or.reduce(
            [np.zeros_like(either), *(r for r in rules if (r & one).sum() > 0.5 * r.sum())]
        )
        for one in planted
    ]
    return {
        "one": [max((_iou(one, rule) for rule in rules), default=0.0) for one in planted],
        "together": [_iou(one, union) for one, union in zip(planted, mine, strict=True)],
        "within": [float((rule & either).sum() / max(rule.sum(), 1)) for rule in rules],
        "best": [max(_iou(one, rule) for one in planted) for rule in rules],
    }


def _iou(one: Bools, other: Bools) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))


def run(
    number: int, *, real: bool, queries: int = QUERIES, alone: bool = False
) -> dict[str, object]:
    """Diagnose a setting by all methods, or ours alone, and return what came out."""
    setting, rng = plant(number), np.random.default_rng([number, 52])
    adversaries = LEARNING if real else ADVERSARIES
    adversary = adversaries[number % len(adversaries)]
    known = (
        attack_for_real(setting, adversary, queries)
        if real
        else ask(setting, adversary, rng, queries)
    )
    start = time.process_time()
    diagnosis = diagnosed(setting, known, rng, queries)
    spent = time.process_time() - start
    ours = judge(setting, by_diagnosis(setting, diagnosis))
    groups = distinct_failures(setting, known, diagnosis)
    ours |= held(setting, diagnosis)
    more = {"seconds": spent, "groups": groups, "fresh": diagnosis.fresh}
    found: dict[str, object] = {OURS: {**ours, **more}}
    for name, method in ({} if alone else OTHERS).items():
        start = time.process_time()
        named = method(setting, known, rng)
        spent = time.process_time() - start
        found[name] = {**judge(setting, named), "seconds": spent}
    return {
        "number": number,
        "adversary": f"{adversary} itself" if real else adversary,
        "dimension": len(setting.space),
        "kinds": [weakness.kind for weakness in setting.planted],
        "found": found,
    }


def tables(rows: list[dict[str, Any]]) -> str:
    """Write the results as Markdown: all methods, and ours by kind, adversary and dimension."""
    lines = [
        "| method | found by one rule | by rules together | false | in part | seconds |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    methods = [name for name in (OURS, *OTHERS) if all(name in row["found"] for row in rows)]
    lines += [f"| {name} | {_cells(rows, name)} |" for name in methods]
    lines += [
        "",
        "| fresh worlds, mean | the true rate in the interval: inside | elsewhere |",
        "| --- | --- | --- |",
        f"| {_checks(rows)} |",
    ]
    lines += [
        "",
        "| sada-gym, of | planted | found by one rule | by rules together |",
        "| --- | --- | --- | --- |",
    ]
    groups: list[tuple[str, Callable[[dict[str, Any], int], bool]]] = [
        *((kind, lambda row, i, k=kind: row["kinds"][i] == k) for kind in KINDS),
        *(
            (f"`{name}`", lambda row, _, n=name: row["adversary"] == n)
            for name in sorted({row["adversary"] for row in rows})
        ),
        *((f"{d} dimensions", lambda row, _, d=d: row["dimension"] == d) for d in DIMENSIONS),
        *((f"{n} at once", lambda row, _, n=n: len(row["kinds"]) == n) for n in range(1, 5)),
    ]
    lines += [f"| {name} | {_recalls(rows, chosen)} |" for name, chosen in groups]
    lines += [
        "",
        "| planted | settings | groups of failures, mean | as many as planted | one more or less |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [f"| {n} | {_groups(rows, n)} |" for n in range(1, 5)]
    return "\n".join(lines)


def _groups(rows: list[dict[str, Any]], planted: int) -> str:
    found = [row["found"][OURS]["groups"] for row in rows if len(row["kinds"]) == planted]
    if not found:
        return "0 | | | "
    apart = np.abs(np.array(found) - planted)
    return f"{len(found)} | {np.mean(found):.1f} | {_percent(apart == 0)} | {_percent(apart == 1)}"


def _cells(rows: list[dict[str, Any]], method: str) -> str:
    found = [row["found"][method] for row in rows]
    one = np.concatenate([f["one"] for f in found]) >= 0.5
    together = one | (np.concatenate([f["together"] for f in found]) >= 0.5)
    within = np.concatenate([f["within"] for f in found])
    best = np.concatenate([f["best"] for f in found])
    false, partly = within < 0.5, (within >= 0.5) & (best < 0.5)
    seconds = np.median([f["seconds"] for f in found])
    shown = [_percent(one), _percent(together), _percent(false), _percent(partly)]
    return " | ".join([*shown, f"{seconds:.1f}"])


def _checks(rows: list[dict[str, Any]]) -> str:
    found = [row["found"][OURS] for row in rows]
    held = (np.concatenate([one[where] for one in found]) > 0 for where in ("inside", "outside"))
    return " | ".join([f"{np.mean([one['fresh'] for one in found]):.0f}", *map(_percent, held)])


def _recalls(rows: list[dict[str, Any]], chosen: Callable[[dict[str, Any], int], bool]) -> str:
    one, together = [], []
    for row in rows:
        found = row["found"][OURS]
        for i in range(len(row["kinds"])):
            if chosen(row, i):
                one.append(found["one"][i] >= 0.5)
                together.append(one[-1] or found["together"][i] >= 0.5)
    if not one:
        return "0 | | "
    return f"{len(one)} | {_percent(np.array(one))} | {_percent(np.array(together))}"


def _percent(hits: Bools) -> str:
    if not len(hits):
        return "none"
    low, high = wilson_interval(int(hits.sum()), len(hits))
    return f"{100 * hits.mean():.1f} % ({100 * low:.0f} to {100 * high:.0f})"


def main() -> None:
    """Run the settings that the file lacks, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--settings", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="develop on 1000 and above")
    parser.add_argument("--real", type=int, default=40, help="so many more by real adversaries")
    parser.add_argument("--queries", type=int, default=QUERIES, help="the budget")
    parser.add_argument("--alone", action="store_true", help="without the other methods")
    parser.add_argument("--out", type=Path, default=Path("planted_weaknesses.jsonl"))
    given = parser.parse_args()
    rows = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {row["number"] for row in rows}
    last = given.first + given.settings
    for number in range(given.first, last + given.real):
        if number in done:
            continue
        rows.append(run(number, real=number >= last, queries=given.queries, alone=given.alone))
        with given.out.open("a") as file:
            file.write(f"{json.dumps(rows[-1])}\n")
    print(tables(rows))


if __name__ == "__main__":
    main()
