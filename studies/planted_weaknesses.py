"""Planted weaknesses: how many does a diagnosis find, and how much of what it names is false?"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sada_gym import Parameter, ParameterSpace
from sada_gym.application import Application, Scored
from sada_gym.arrays import Bools, Floats
from sada_gym.diagnosis.core import diagnose_worlds
from sada_gym.diagnosis.grouping import grouped
from sada_gym.diagnosis.record import Diagnosis
from sada_gym.diagnosis.rules import holds
from sada_gym.diagnosis.run import default_fresh
from sada_gym.evaluations import Evaluations
from sada_gym.measures.rates import wilson_interval
from sada_gym.parameters import Mu

AROUND = ("in front", "on the left", "behind", "on the right")
DIMENSIONS = (2, 3, 4, 6, 8, 10)
KINDS = ("box", "band", "cyclic", "thin", "choice", "ellipse", "diagonal")
ADVERSARIES = ("level-set", "random", "bbgan")
LEARNING = ("level-set", "bbgan")
_QUERIES, _SAMPLES = 2_000, 250
_TESTED = 40_000
_MOST_TOGETHER = 0.4
_THRESHOLD = 0.5


@dataclass(frozen=True)
class Planted:
    """A planted weakness: which shares of the ranges, (n, d), lie in it, and how often it fools."""

    kind: str
    contains: Callable[[Floats], Bools]
    rate: float
    volume: float


@dataclass(frozen=True)
class Setting:
    """A space with planted weaknesses, and the rate at which the agent is fooled elsewhere."""

    seed: int
    space: ParameterSpace
    planted: tuple[Planted, ...]
    elsewhere: float

    def rates(self, shares: Floats) -> Floats:
        """Return how often each world fools, (n,)."""
        found = np.full(len(shares), self.elsewhere)
        for weakness in self.planted:
            inside = weakness.contains(shares)
            found[inside] = np.maximum(found[inside], weakness.rate)
        return found


class PlantedApplication(Application):
    """Fools with the chances of a setting: a score of 0 or 1, fixed by mu and the seed."""

    name = "planted"
    fooling_threshold = _THRESHOLD
    sample_size = 250

    def __init__(self, setting: Setting) -> None:
        self.setting, self.parameters = setting, setting.space

    @property
    def settings(self) -> dict[str, int]:
        return {"seed": self.setting.seed}

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        drawn = np.array([np.random.default_rng(seed).random() for seed in seeds])
        fooled = drawn < self.setting.rates((mu.astype(np.float64) + 1.0) / 2.0)
        return Scored(1.0 - fooled, [{} for _ in seeds])


def plant(seed: int) -> Setting:
    """Make the setting of a seed."""
    rng = np.random.default_rng([seed, 50])
    while True:
        space = _space(rng)
        wanted = 1 + int(rng.integers(4))
        shares = rng.random((_TESTED, len(space)))
        planted: list[Planted] = []
        taken = np.zeros(_TESTED, np.bool_)
        for _ in range(200):
            if len(planted) == wanted:
                break
            kind, contains = _shape(rng, space)
            inside = contains(shares)
            volume = float(inside.mean())
            if not 0.02 <= volume <= 0.25 or (taken & inside).sum() > 0.1 * inside.sum():
                continue
            if (taken | inside).mean() > _MOST_TOGETHER:
                continue
            taken |= inside
            planted.append(Planted(kind, contains, float(rng.uniform(0.6, 1.0)), volume))
        if len(planted) == wanted:
            return Setting(seed, space, tuple(planted), float(rng.uniform(0.0, 0.1)))


def _space(rng: np.random.Generator) -> ParameterSpace:
    parameters = []
    for i in range(int(rng.choice(DIMENSIONS))):
        kind = rng.choice(["plain", "plain", "plain", "around", "choice", "whole", "log"])
        if kind == "around":
            parameters.append(Parameter(f"p{i}_deg", -180.0, 180.0, "deg", directions=AROUND))
        elif kind == "choice":
            count = int(rng.integers(3, 7))
            names = tuple("abcdef"[:count])
            parameters.append(Parameter(f"p{i}", 0.0, float(count), choices=names))
        elif kind == "whole":
            parameters.append(Parameter(f"p{i}", 0.5, 0.5 + int(rng.integers(4, 13)), whole=True))
        elif kind == "log":
            parameters.append(Parameter(f"p{i}", 0.01, 10.0, log=True))
        else:
            low = float(rng.choice([0.0, -1.0, 5.0]))
            high = low + float(rng.choice([1.0, 7.3, 60.0]))
            parameters.append(Parameter(f"p{i}_m", low, high, "m"))
    return ParameterSpace(*parameters)


def _is_plain(parameter: Parameter) -> bool:
    return not (parameter.choices or parameter.whole or parameter.directions)


def _shape(
    rng: np.random.Generator, space: ParameterSpace
) -> tuple[str, Callable[[Floats], Bools]]:
    d = len(space)
    kind = str(rng.choice(KINDS))
    plain = [i for i, p in enumerate(space.parameters) if _is_plain(p)]
    around = [i for i, p in enumerate(space.parameters) if p.directions]
    choices = [i for i, p in enumerate(space.parameters) if p.choices]
    linear = [i for i in plain if not space.parameters[i].log]
    if kind == "ellipse" and len(plain) >= 2:
        return kind, _ellipse(rng, *rng.choice(plain, 2, replace=False).tolist())
    if kind == "diagonal" and len(linear) >= 2:
        return kind, _diagonal(rng, *rng.choice(linear, 2, replace=False).tolist())
    if kind == "band":
        i = int(rng.integers(d))
        return kind, _all([_range(rng, space, i, rng.uniform(0.06, 0.25))])
    if kind == "cyclic" and around:
        i = int(rng.choice(around))
        rest = [j for j in range(d) if j != i]
        parts = [_range(rng, space, i, rng.uniform(0.1, 0.35))]
        if rng.random() < 0.5:
            parts.append(_range(rng, space, int(rng.choice(rest)), rng.uniform(0.3, 0.6)))
        return kind, _all(parts)
    if kind == "thin" and plain:
        i = int(rng.choice(plain))
        return kind, _all([_range(rng, space, i, rng.uniform(0.025, 0.05))])
    if kind == "choice" and choices:
        i = int(rng.choice(choices))
        rest = [j for j in range(d) if j != i]
        parts = [_range(rng, space, i, rng.uniform(0.2, 0.5))]
        parts.append(_range(rng, space, int(rng.choice(rest)), rng.uniform(0.2, 0.6)))
        return kind, _all(parts)
    count = int(rng.integers(2, min(d, 3) + 1))
    volume = rng.uniform(0.02, 0.12)
    cuts = rng.dirichlet(np.full(count, 6.0))
    members = rng.choice(d, count, replace=False)
    return "box", _all(
        [_range(rng, space, int(i), volume**cut) for i, cut in zip(members, cuts, strict=True)]
    )


def _all(parts: Sequence[Callable[[Floats], Bools]]) -> Callable[[Floats], Bools]:
    return lambda shares: np.logical_and.reduce([part(shares) for part in parts])


def _range(
    rng: np.random.Generator, space: ParameterSpace, i: int, width: float
) -> Callable[[Floats], Bools]:
    parameter = space.parameters[i]
    if parameter.choices:
        count = len(parameter.choices)
        taken = rng.choice(count, max(1, round(width * count)), replace=False)
        return lambda s: np.isin(np.minimum((s[:, i] * count).astype(int), count - 1), taken)
    if parameter.directions:
        start = rng.random()
        return lambda s: (s[:, i] - start) % 1.0 < width
    if parameter.whole:
        count = round(parameter.high - parameter.low)
        size = max(1, round(width * count))
        first = int(rng.integers(count - size + 1))
        return lambda s: (s[:, i] >= first / count) & (s[:, i] < (first + size) / count)
    # a third of them begin or end with the range
    place = rng.choice([0.0, 1.0, rng.random(), rng.random()])
    low = place * (1.0 - width)
    return lambda s: (s[:, i] >= low) & (s[:, i] <= low + width)


def _ellipse(rng: np.random.Generator, a: int, b: int) -> Callable[[Floats], Bools]:
    area, aspect, angle = rng.uniform(0.03, 0.15), rng.uniform(1.0, 2.5), rng.uniform(0, np.pi)
    half = np.sqrt(area / np.pi * np.array([aspect, 1.0 / aspect]))
    centre = rng.uniform(0.2, 0.8, 2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def contains(shares: Floats) -> Bools:
        place = (shares[:, [a, b]] - centre) @ turn.T / half
        return (place**2).sum(axis=1) <= 1.0

    return contains


def _diagonal(rng: np.random.Generator, a: int, b: int) -> Callable[[Floats], Bools]:
    slope = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    centre, width = rng.uniform(-0.6, 0.6), rng.uniform(0.05, 0.25)

    def contains(shares: Floats) -> Bools:
        across = (shares[:, a] - 0.5) + slope * (shares[:, b] - 0.5)
        return np.abs(across - centre) <= width / 2.0

    return contains


@dataclass(frozen=True)
class Known:
    """What a run knows: shares of the ranges, (n, d), which fooled, and which are uniform."""

    shares: Floats
    fooled: Bools
    uniform: Bools


def ask(setting: Setting, adversary: str, rng: np.random.Generator) -> Known:
    """Choose queries and samples as an adversary does, or nearly so: quickly."""
    first = _QUERIES if adversary != "level-set" else int(0.4 * _QUERIES)
    shares = rng.random((first, len(setting.space)))
    fooled = rng.random(first) < setting.rates(shares)
    if adversary == "random":
        samples = rng.random((_SAMPLES, len(setting.space)))
    elif adversary == "bbgan":  # learns the points that fooled, not quite
        centres = shares[fooled][rng.integers(max(fooled.sum(), 1), size=_SAMPLES)]
        samples = np.clip(centres + 0.05 * rng.normal(size=centres.shape), 0.0, 1.0)
    else:
        shares, fooled, samples = _level_set(setting, shares, fooled, rng)
    uniform = np.arange(len(shares) + len(samples)) < first
    if adversary == "random":
        uniform[:] = True
    more = rng.random(len(samples)) < setting.rates(samples)
    return Known(np.concatenate([shares, samples]), np.append(fooled, more), uniform)


def _level_set(
    setting: Setting, shares: Floats, fooled: Bools, rng: np.random.Generator
) -> tuple[Floats, Bools, Floats]:
    """Ask at the border of where a forest predicts failures; then sample beyond it."""
    for _ in range(4):
        pool = rng.random((8_000, len(setting.space)))
        p = _forest(shares, fooled, rng)(pool)
        odds = p * (1.0 - p) + 1e-9
        odds = 0.75 * odds / odds.sum() + 0.25 / len(pool)
        new = pool[rng.choice(len(pool), (_QUERIES * 6 // 10) // 4, replace=False, p=odds)]
        shares = np.concatenate([shares, new])
        fooled = np.append(fooled, rng.random(len(new)) < setting.rates(new))
    pool = rng.random((8_000, len(setting.space)))
    best = np.argsort(-_forest(shares, fooled, rng)(pool))
    return shares, fooled, pool[rng.permutation(best[: 2 * _SAMPLES])[:_SAMPLES]]


def _forest(shares: Floats, fooled: Bools, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    from sklearn.ensemble import ExtraTreesClassifier

    forest = ExtraTreesClassifier(
        30, min_samples_leaf=3, random_state=int(rng.integers(2**31))
    ).fit(shares, fooled)
    return lambda pool: forest.predict_proba(pool)[:, -1] if fooled.any() else np.zeros(len(pool))


def attack_for_real(setting: Setting, adversary: str) -> Known:
    """Let the real adversary choose queries and samples."""
    from sada_gym import adversaries
    from sada_gym.oracle import Oracle

    application = PlantedApplication(setting)
    solver = adversaries.make(adversary, dimension=len(setting.space), seed=setting.seed)
    with Oracle(application, budget=_QUERIES, seed=setting.seed) as oracle:
        solver.train(oracle)
        record = oracle.record
    with Oracle(application, budget=_SAMPLES, seed=setting.seed, stream="test") as oracle:
        oracle(solver.sample(_SAMPLES))
        samples = oracle.record
    both = record + samples
    even = np.arange(len(both)) < solver.uniform_part(len(record))
    return Known((both.mu.astype(np.float64) + 1.0) / 2.0, both.fooled(_THRESHOLD), even)


Named = list[Callable[[Floats], Bools]]
"""What a method names: which shares, (n, d), lie in each rule."""


def diagnosed(setting: Setting, known: Known, rng: np.random.Generator) -> Diagnosis:
    """Diagnose as `sada-gym diagnose` does."""
    mu = (2.0 * known.shares - 1.0).astype(np.float32)

    def evaluate(mu: Mu) -> tuple[Bools, Bools]:
        fooled = rng.random(len(mu)) < setting.rates((mu.astype(np.float64) + 1.0) / 2.0)
        return fooled, np.ones(len(mu), np.bool_)

    return diagnose_worlds(
        setting.space,
        Evaluations(mu, 1.0 - known.fooled, np.arange(len(mu))),
        _THRESHOLD,
        known.uniform,
        evaluate=evaluate,
        fresh=default_fresh(_QUERIES),
        seed=setting.seed,
    )


def by_diagnosis(setting: Setting, diagnosis: Diagnosis) -> Named:
    """Name the weaknesses of a diagnosis."""
    return [
        lambda shares, one=one: holds(one.conditions, setting.space, 2.0 * shares - 1.0)
        for one in diagnosis.weaknesses
    ]


def distinct_failures(setting: Setting, known: Known, diagnosis: Diagnosis) -> int:
    """Count the groups of the failures among the samples; those in no weakness where all are."""
    mu = (2.0 * known.shares[-_SAMPLES:] - 1.0).astype(np.float32)
    groups = grouped(diagnosis, setting.space, mu[known.fooled[-_SAMPLES:]])
    return sum(group.weakness != 0 for group in groups) or len(groups)


def by_prim(_: Setting, known: Known, __: np.random.Generator) -> Named:
    """Name boxes by PRIM (Friedman and Fisher 1999), of each trajectory the one of the best F1.

    At least half of the worlds in a box fool. Boxes are peeled by 5 % of the worlds in them, down
    to 2 % of all, pasted by as many, and found one after another.
    """
    left, named = np.ones(len(known.fooled), np.bool_), []
    while len(named) < 5:
        box = _peel(known.shares[left], known.fooled[left])
        inside = left & _in_box(box, known.shares)
        if not inside.any() or known.fooled[inside].mean() < 0.5:
            break
        named.append(lambda shares, box=box: _in_box(box, shares))
        left &= ~inside
    return named


def _in_box(box: Floats, shares: Floats) -> Bools:
    return np.asarray(((shares >= box[0]) & (shares <= box[1])).all(axis=1))


def _peel(shares: Floats, fooled: Bools) -> Floats:
    box = np.stack([np.zeros(shares.shape[1]), np.ones(shares.shape[1])])
    total, best, best_f1 = max(int(fooled.sum()), 1), box.copy(), 0.0
    inside = np.ones(len(shares), np.bool_)
    while inside.sum() > 0.02 * len(shares):
        tried = []
        for j in range(shares.shape[1]):
            for side, quantile in ((0, 0.05), (1, 0.95)):
                smaller = box.copy()
                smaller[side, j] = np.quantile(shares[inside, j], quantile)
                kept = inside & _in_box(smaller, shares)
                if 0 < kept.sum() < inside.sum():
                    tried.append((fooled[kept].mean(), j, side, smaller, kept))
        if not tried:
            break
        *_, box, inside = max(tried, key=lambda one: one[0])
        hits = fooled[inside].sum()
        f1 = 2.0 * hits / (inside.sum() + total) if hits >= 0.5 * inside.sum() else 0.0
        if f1 > best_f1:
            best, best_f1 = box.copy(), f1
    return _paste(best, shares, fooled)


def _paste(box: Floats, shares: Floats, fooled: Bools) -> Floats:
    while True:
        inside = _in_box(box, shares)
        mean, more = fooled[inside].mean(), max(int(0.05 * inside.sum()), 1)
        best = None
        for j in range(shares.shape[1]):
            other = _in_box(np.delete(box, j, axis=1), np.delete(shares, j, axis=1)) & ~inside
            for side in (0, 1):
                beyond = shares[other, j]
                beyond = beyond[beyond < box[0, j]] if side == 0 else beyond[beyond > box[1, j]]
                if not len(beyond):
                    continue
                ordered = np.sort(beyond) if side else -np.sort(-beyond)
                larger = box.copy()
                larger[side, j] = ordered[min(more, len(ordered)) - 1]
                rate = fooled[_in_box(larger, shares)].mean()
                if rate > mean:
                    best, mean = larger, rate
        if best is None:
            return box
        box = best


def by_tree(_: Setting, known: Known, __: np.random.Generator) -> Named:
    """Name the leaves of a tree in which most worlds fool; its size by cross-validation."""
    from sklearn.model_selection import GridSearchCV
    from sklearn.tree import DecisionTreeClassifier

    search = GridSearchCV(
        DecisionTreeClassifier(min_samples_leaf=15, random_state=0),
        {"max_leaf_nodes": [2, 4, 8, 16, 32]},
        scoring="neg_log_loss",
    ).fit(known.shares, known.fooled)
    tree = search.best_estimator_
    leaf = tree.apply(known.shares)
    weak = [i for i in np.unique(leaf) if known.fooled[leaf == i].mean() >= 0.5]
    return [lambda shares, i=i: tree.apply(shares) == i for i in weak]


OURS = "sada-gym"
OTHERS = {"PRIM": by_prim, "decision tree": by_tree}


def judge(setting: Setting, named: Named) -> dict[str, list[float]]:
    """Measure what is named by uniform worlds.

    Of each planted weakness: the greatest intersection over union with a rule, and that with all
    rules together most of whose volume lies in it. Of each rule: the share of its volume in any
    planted weakness, and its greatest intersection over union with one.
    """
    shares = np.random.default_rng([setting.seed, 51]).random((_TESTED, len(setting.space)))
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


def run(number: int, *, real: bool) -> dict[str, object]:
    """Diagnose a setting by all methods, and return what came out."""
    setting, rng = plant(number), np.random.default_rng([number, 52])
    adversaries = LEARNING if real else ADVERSARIES
    adversary = adversaries[number % len(adversaries)]
    known = attack_for_real(setting, adversary) if real else ask(setting, adversary, rng)
    start = time.process_time()
    diagnosis = diagnosed(setting, known, rng)
    spent = time.process_time() - start
    ours = judge(setting, by_diagnosis(setting, diagnosis))
    groups = distinct_failures(setting, known, diagnosis)
    found: dict[str, object] = {OURS: {**ours, "seconds": spent, "groups": groups}}
    for name, method in OTHERS.items():
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
    lines += [f"| {name} | {_cells(rows, name)} |" for name in (OURS, *OTHERS)]
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
    parser.add_argument("--out", type=Path, default=Path("planted_weaknesses.jsonl"))
    given = parser.parse_args()
    rows = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {row["number"] for row in rows}
    last = given.first + given.settings
    for number in range(given.first, last + given.real):
        if number in done:
            continue
        rows.append(run(number, real=number >= last))
        with given.out.open("a") as file:
            file.write(f"{json.dumps(rows[-1])}\n")
    print(tables(rows))


if __name__ == "__main__":
    main()
