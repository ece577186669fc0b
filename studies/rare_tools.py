"""Small probabilities of failure by OpenTURNS, plain draws and `sada-gym estimate`, side by side.

    python -m studies.rare_tools --runs 50 --ours 200 --store docs/results/ordinary-use/judge.csv

On the twenty problems of `studies.rare` on which nothing was chosen, with at most 2,000 queries a
run. OpenTURNS comes with the extra `studies`. Its runs take a hundredth of a second; `--ours` are
the runs of `sada-gym estimate`, a second each, of which those that `studies.rare --store` has kept
are taken from there.

The settings of OpenTURNS were chosen as ours were, on the other twenty problems: `--settings`
prints how each did there with 20 runs, and what has the least error beside plain draws is taken.
Subset simulation and cross-entropy need a number of draws a level, and do not say beforehand how
many levels there will be: a run that needs more than 2,000 queries gives no answer. Nor does one
that ends with an error, or with 0 and no interval. In the errors no answer counts as 0.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import openturns as ot

from studies.rare import (
    QUERIES,
    Floats,
    Method,
    Outcome,
    Problem,
    coverage,
    error,
    held,
    in_rounds,
    now,
    numbers_of,
    plain,
    problems,
)

CONFIDENCE = 0.95
_ONE_MORE = 40  # queries that a direction may take


class Limit:
    """A problem as OpenTURNS asks it: a function of points that counts, and ends, its queries."""

    def __init__(self, number: int, problem: Problem, seed: int) -> None:
        self._problem, self.queries = problem, 0
        self.dimension = problem.dimension
        self.rng = np.random.default_rng((number, seed, 2))
        self._noise = np.random.default_rng((number, seed, 1))
        ot.RandomGenerator.SetSeed(10_000 * number + seed)
        function = ot.PythonFunction(self.dimension, 1, func_sample=self._depths)
        draws = ot.RandomVector(ot.Normal(self.dimension))
        vector = ot.CompositeRandomVector(function, draws)
        self.stop = self._spent  # OpenTURNS does not keep it
        self.event = ot.ThresholdEvent(vector, ot.LessOrEqual(), 0.0)

    def _depths(self, points: object) -> Floats:
        z = np.asarray(points, np.float64).reshape(-1, self.dimension)
        self.queries += len(z)
        if self.queries > QUERIES:
            raise RuntimeError(f"Expected at most {QUERIES} queries.")
        return (self._problem.answers(z, self._noise).score - 0.5)[:, None]

    def _spent(self) -> int:
        return int(self.queries > QUERIES - _ONE_MORE)


Algorithm = Callable[[Limit], ot.SimulationAlgorithm]


def in_one_block(algorithm: ot.SimulationAlgorithm, draws: int) -> ot.SimulationAlgorithm:
    """Let each level, or the only one, have so many draws."""
    algorithm.setBlockSize(draws)
    algorithm.setMaximumOuterSampling(1)
    return algorithm


def subset(draws: int, limit: Limit) -> ot.SimulationAlgorithm:
    return in_one_block(ot.SubsetSampling(limit.event), draws)


def cross_entropy(level: float, draws: int, limit: Limit) -> ot.SimulationAlgorithm:
    made = ot.StandardSpaceCrossEntropyImportanceSampling(limit.event, level)
    return in_one_block(made, draws)


def directional(root: type[ot.RootStrategyImplementation], limit: Limit) -> ot.SimulationAlgorithm:
    made = ot.DirectionalSampling(limit.event, root(), ot.RandomDirection())
    made.setBlockSize(1)
    made.setMaximumOuterSampling(QUERIES)
    made.setMaximumCoefficientOfVariation(-1.0)  # only the queries end it
    made.setStopCallback(limit.stop)
    return made


def form(solver: Callable[[], object], drawn: bool, limit: Limit) -> ot.SimulationAlgorithm:
    """Search the most likely failure (FORM); then draw around it."""
    start = limit.rng.normal(size=limit.dimension) if drawn else np.zeros(limit.dimension)
    search = ot.FORM(solver(), limit.event, start.tolist())
    search.run()
    made = ot.PostAnalyticalImportanceSampling(search.getResult())
    made.setMaximumCoefficientOfVariation(-1.0)
    return in_one_block(made, QUERIES - limit.queries)


def by_openturns(make: Algorithm, number: int, problem: Problem, seed: int) -> Outcome:
    """Run an algorithm of OpenTURNS, and return its interval, which is normal."""
    limit = Limit(number, problem, seed)
    try:
        algorithm = make(limit)
        algorithm.run()
        result = algorithm.getResult()
        rate = result.getProbabilityEstimate()
        half = result.getConfidenceLength(CONFIDENCE) / 2.0
    except (RuntimeError, TypeError):  # its own errors come as these
        rate, half = 0.0, 0.0
    if not rate > 0.0:
        return Outcome(np.nan, np.nan, np.nan, True, min(limit.queries, QUERIES))
    return Outcome(rate, rate - half, rate + half, False, limit.queries)


def settings() -> dict[str, dict[str, Method]]:
    """Return the settings of each method of OpenTURNS that are tried."""
    sizes = (200, 285, 400, 500, 666)
    tried: dict[str, dict[str, Algorithm]] = {
        "subset simulation": {f"{n} a level": partial(subset, n) for n in sizes},
        "cross-entropy": {
            f"{n} a level of {level:.2f}": partial(cross_entropy, level, n)
            for level in (0.1, 0.25)
            for n in sizes
        },
        "directional sampling": {
            one.__name__: partial(directional, one)
            for one in (ot.SafeAndSlow, ot.MediumSafe, ot.RiskyAndFast)
        },
        "FORM, then importance sampling": {
            f"{solver.__name__}, {'drawn' if drawn else 'mean'} start": partial(form, solver, drawn)
            for solver in (ot.AbdoRackwitz, ot.Cobyla)
            for drawn in (False, True)
        },
    }
    return {
        name: {setting: partial(by_openturns, make) for setting, make in made.items()}
        for name, made in tried.items()
    }


CHOSEN = {
    "subset simulation": "400 a level",
    "cross-entropy": "500 a level of 0.10",
    "directional sampling": "RiskyAndFast",
    "FORM, then importance sampling": "Cobyla, drawn start",
}
"""The settings with the least error beside that of plain draws on the other half."""


def answers(runs: Sequence[Outcome]) -> Floats:
    """Return the rates and intervals of runs, (n, 3); NaN without an answer, or if refused."""
    return np.array([(np.nan,) * 3 if one.refused else one[:3] for one in runs])


def answered(runs: Sequence[Outcome]) -> Floats:
    """Return the rates and intervals of the runs that gave one, (n, 3)."""
    found = answers(runs)
    return found[np.isfinite(found[:, 0])]


def errors(runs: dict[int, list[Outcome]]) -> Floats:
    """Return the relative error on each problem, no answer being 0, (n,)."""
    every = problems()
    return np.array(
        [error(np.nan_to_num(answers(of)), every[number].truth) for number, of in runs.items()]
    )


def plain_errors(numbers: Sequence[int]) -> Floats:
    """Return the relative error of plain draws, (n,)."""
    truth = np.array([problems()[number].truth for number in numbers])
    return np.asarray(np.sqrt((1.0 - truth) / truth / QUERIES))


def summary(name: str, runs: dict[int, list[Outcome]]) -> Iterator[str]:
    """Yield the cells of a method's row over all problems."""
    every = problems()
    kept = {number: answered(of) for number, of in runs.items()}
    holds = {number: held(found, every[number].truth) for number, found in kept.items()}
    ratio = errors(runs) / plain_errors(list(runs))
    yield name
    yield f"{np.median(errors(runs)):.2f}"
    yield f"{np.median(ratio):.2f}"
    yield coverage(np.concatenate(list(holds.values())))
    good = [len(one) > 0 and one.mean() >= 0.9 for one in holds.values()]
    yield f"{sum(good)} of {len(runs)}"
    total = sum(map(len, runs.values()))
    yield f"{total - sum(map(len, kept.values()))} of {total:,}"
    yield f"{np.mean([run.queries for of in runs.values() for run in of]):,.0f}"


def cell(problem: Problem, runs: Sequence[Outcome]) -> str:
    """Write the error, how often the interval held, and in how many runs there was no answer."""
    found = answered(runs)
    text = f"{error(np.nan_to_num(answers(runs)), problem.truth):.2f}"
    if len(found):
        text += f", {100 * held(found, problem.truth).mean():.0f} %"
    none = len(runs) - len(found)
    return f"{text}, {none} none" if none else text


def table(heads: Sequence[str], rows: Iterator[Iterator[str]]) -> None:
    """Print a table in Markdown."""
    print("|", " | ".join(heads), "|")
    print("| --- " * len(heads) + "|")
    for cells in rows:
        print("|", " | ".join(cells), "|", flush=True)
    print()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--ours", type=int, default=24)
    parser.add_argument("--store", type=Path, help="a file that keeps the runs")
    parser.add_argument("--settings", action="store_true", help="how settings do on the other half")
    given = parser.parse_args()
    tried = settings()
    heads = ["method", "error", "/ plain", "held", "held in 90 %", "no answer", "queries"]
    ot.Log.Show(ot.Log.NONE)
    if given.settings:
        methods = {f"{m}: {s}": run for m, made in tried.items() for s, run in made.items()}
    else:
        methods = {name: tried[name][setting] for name, setting in CHOSEN.items()}
        methods["plain draws"] = plain
    numbers = numbers_of("choose" if given.settings else "judge")
    found = in_rounds(methods, numbers, given.runs, given.store)
    if given.ours and not given.settings:
        found |= in_rounds({"now": now}, numbers, given.ours, given.store)
        methods = {"now": now, **methods}
    by_method = {name: {n: found[name, n] for n in numbers} for name in methods}
    table(heads, (summary(name, runs) for name, runs in by_method.items()))
    if not given.settings:
        every = problems()
        rows = (
            iter(
                [every[n].name, f"{every[n].dimension}", f"{every[n].truth:.1e}"]
                + [cell(every[n], found[name, n]) for name in methods]
            )
            for n in numbers
        )
        table(["problem", "d", "p", *methods], rows)


if __name__ == "__main__":
    main()
