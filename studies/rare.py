"""How often intervals of small probabilities of failure hold the truth, and how large errors are.

    python -m studies.rare --half judge --runs 200 --minutes 35 --store rare.csv

Forty problems have a probability that is known exactly: 2 to 12 standard normal parameters, 1e-1 to
1e-6, one to four regions, smooth and spotted, noisy or not, and regions that no score shows. The
settings of `sada_gym.analyses.estimation` were chosen on those with even numbers; `--half judge`
takes the others. Each run has 2,000 queries. "Weighted uniform": uniform worlds within 6 standard
deviations, weighted by the density, as an attack's summary has them.

A run takes about a second of one core. They go in rounds, a run of each problem a round, so that
every problem has as many runs wherever the time ends; the table counts whole rounds alone. With
`--store` the same command goes on after a stop, and adds rounds after its time was over.
"""

from __future__ import annotations

import argparse
import csv
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import chi2, ncx2, norm

from sada_gym.analyses.estimation.core import Answers, estimate_probability
from sada_gym.analyses.estimation.interval import exact_interval
from sada_gym.measures.rates import weighted_rate, wilson_interval

Floats = npt.NDArray[np.float64]

QUERIES = 2_000
WITHIN = 6.0
BEFORE_RUNS = 200


@dataclass(frozen=True)
class Problem:
    """Worlds that fail where a margin, with noise of a standard deviation, is not above 0.

    Attributes:
        truth: The probability.
        margin: The margin at points, (n, d): (n,).
        chance: Each world fails with this chance, whatever its margin.
        flat: Whether scores tell no more than whether a world fails.
    """

    name: str
    dimension: int
    truth: float
    margin: Callable[[Floats], Floats]
    noise: float = 0.0
    chance: float = 0.0
    flat: bool = False

    def answers(self, z: Floats, rng: np.random.Generator) -> Answers:
        """Score points, (n, d), with a threshold of 0.5."""
        margin = self.margin(z) + (self.noise * rng.normal(size=len(z)) if self.noise else 0.0)
        if self.chance:
            margin = np.where(rng.random(len(z)) < self.chance, -1.0, margin)
        failed = margin <= 0.0
        score = np.where(failed, 0.0, 1.0) if self.flat else np.clip(0.5 + 0.1 * margin, 0.0, 1.0)
        score = np.where(failed, np.minimum(score, 0.5), np.maximum(score, 0.5 + 1e-9))
        return Answers(score, failed, np.ones(len(z), np.bool_))


class Normal:
    """Ordinary use: independent standard normal parameters."""

    def __init__(self, dimension: int) -> None:
        self.dimension = dimension

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw points, (count, d)."""
        return rng.normal(size=(count, self.dimension))

    def log_density(self, z: Floats) -> Floats:
        """Return the logarithm of the density, (n,)."""
        return np.asarray(-0.5 * ((z**2).sum(axis=1) + self.dimension * np.log(2 * np.pi)))


def directions(dimension: int, count: int) -> Floats:
    """Return perpendicular directions that are no axes, (d, count)."""
    rng = np.random.default_rng(dimension * 7 + count)
    return np.linalg.qr(rng.normal(size=(dimension, dimension)))[0][:, :count]


def half_spaces(d: int, p: float, count: int = 1, noise: float = 0.0) -> Problem:
    """Return half-spaces with unequal probabilities, the sum of which is p."""
    shares = np.array([0.55, 0.25, 0.15, 0.05])[:count]
    each = p * shares / shares.sum()
    u, far = directions(d, count), norm.isf(each) * np.sqrt(1.0 + noise**2)

    def at(error: float) -> float:
        return float((1.0 - np.prod(ndtr(far + error * noise))) * norm.pdf(error))

    truth = 1.0 - np.prod(1.0 - each)
    if noise and count > 1:  # they share the noise
        truth = quad(at, -8.0, 8.0, points=[-5.0, -3.0, 0.0], limit=200)[0]
    name = f"{count} half-space{'s' * (count > 1)}{', noisy' if noise else ''}"
    return Problem(name, d, float(truth), lambda z: (far - z @ u).min(axis=1), noise)


def both_ends(d: int, p: float) -> Problem:
    far, u = norm.isf(p / 2.0), directions(d, 1)[:, 0]
    return Problem("both ends", d, p, lambda z: far - np.abs(z @ u))


def corner(d: int, p: float, count: int, *, turned: bool = True) -> Problem:
    u = directions(d, count) if turned else np.eye(d)[:, :count]
    far = norm.isf(p ** (1.0 / count))
    name = f"corner of {count}{'' if turned else ' axes'}"
    return Problem(name, d, p, lambda z: (far - z @ u).max(axis=1))


def ball(d: int, p: float, count: int) -> Problem:
    radius = np.sqrt(chi2.isf(p, count))
    name = f"outside a ball in {count}"
    return Problem(name, d, p, lambda z: radius - np.linalg.norm(z[:, :count], axis=1))


def parabola(d: int, p: float, bend: float) -> Problem:
    def held(far: float) -> float:
        return float(quad(lambda t: norm.sf(far + bend * t * t) * norm.pdf(t), -8, 8)[0])

    far, u = brentq(lambda far: np.log(held(far) / p), -1.0, 8.0), directions(d, 2)
    name = f"parabola, bent {'away' if bend > 0 else 'around'}"
    return Problem(name, d, p, lambda z: far + bend * (z @ u[:, 1]) ** 2 - z @ u[:, 0])


def spots(d: int, p: float, count: int, *, flat: bool = False) -> Problem:
    """Return balls 2.5 away from the middle; with `flat` scores no score leads there."""
    u = 2.5 * directions(d, min(count, d)).T
    centres = np.concatenate([u, -u])[:count]
    radius = brentq(lambda r: ncx2.cdf(r * r, d, 2.5**2) - p / count, 1e-6, 10.0)

    def margin(z: Floats) -> Floats:
        distances = [np.linalg.norm(z - centre, axis=1) for centre in centres]
        return np.asarray(1.5 * (np.min(distances, axis=0) - radius))

    name = f"{count} spot{'s' * (count > 1)}{', no slope' if flat else ''}"
    return Problem(name, d, p, margin, flat=flat)


def hidden(d: int, p: float, share: float) -> Problem:
    """Return a half-space, and a ball that no score shows with so much of the probability."""
    shown, u = half_spaces(d, p * (1.0 - share)), directions(d, 1)[:, 0]
    radius = brentq(lambda r: ncx2.cdf(r * r, d, 1.5**2) - p * share, 1e-6, 10.0)

    def margin(z: Floats) -> Floats:
        inside = np.linalg.norm(z + 1.5 * u, axis=1) < radius
        return np.where(inside, -1.0, shown.margin(z))

    return Problem(f"{share:.0%} hidden".replace("%", " %"), d, p, margin)


def anywhere(d: int, p: float, chance: float) -> Problem:
    shown = half_spaces(d, (p - chance) / (1.0 - chance))
    return replace(shown, name="half by chance, anywhere", truth=p, chance=chance)


def four_branches(p: float) -> Problem:
    def margin(a: Floats, b: Floats, far: float) -> Floats:
        diagonal = far + 0.1 * (a - b) ** 2 - np.abs(a + b) / 2**0.5
        return np.minimum(diagonal, 1.4 * far - np.abs(a - b))

    grid = np.linspace(-8.0, 8.0, 1_601)
    a, b = np.meshgrid(grid, grid)
    weight = norm.pdf(a) * norm.pdf(b) * 0.01**2

    def held(far: float) -> float:
        return float((weight * ndtr(-margin(a, b, far) / 0.003)).sum())

    far = brentq(lambda far: np.log(held(far) / p), 1.0, 6.0)
    return Problem("four branches", 2, held(far), lambda z: margin(z[:, 0], z[:, 1], far))


@cache
def problems() -> list[Problem]:
    """Return the forty problems."""
    return [
        half_spaces(2, 1e-1), half_spaces(4, 1e-3, noise=0.3), half_spaces(8, 1e-4),
        half_spaces(12, 1e-6), half_spaces(2, 1e-3, 2), half_spaces(4, 1e-4, 2),
        half_spaces(8, 1e-4, 2), half_spaces(4, 1e-6, 2), half_spaces(8, 1e-3, 4),
        half_spaces(12, 1e-4, 4), half_spaces(4, 1e-2, 3, 0.3), half_spaces(12, 1e-3, 2, 0.3),
        both_ends(4, 1e-3), both_ends(8, 1e-4), both_ends(12, 1e-5), both_ends(2, 1e-6),
        corner(4, 1e-3, 2), corner(8, 1e-4, 2), corner(12, 1e-3, 3),
        corner(4, 1e-4, 3, turned=False), corner(8, 1e-3, 3, turned=False),
        corner(12, 1e-4, 2, turned=False), ball(4, 1e-3, 4), ball(8, 1e-4, 8),
        ball(12, 1e-3, 2), ball(8, 1e-3, 3), parabola(2, 1e-4, 0.25), parabola(8, 1e-3, 0.25),
        parabola(4, 1e-4, -0.15), parabola(12, 1e-3, -0.15), spots(2, 1e-3, 1),
        spots(4, 1e-3, 1), spots(2, 1e-3, 3), spots(4, 1e-4, 2), spots(2, 1e-2, 2, flat=True),
        spots(4, 1e-3, 1, flat=True), hidden(4, 1e-2, 0.5), hidden(2, 1e-1, 0.2),
        anywhere(6, 1e-2, 5e-3), four_branches(1e-3),
    ]  # fmt: skip


def before(problem: Problem, seed: int) -> tuple[float, float, float]:
    """Return the rate and the interval of uniform worlds that are weighted by the density."""
    rng = np.random.default_rng((seed, zlib.crc32(problem.name.encode())))
    z = rng.uniform(-WITHIN, WITHIN, (QUERIES, problem.dimension))
    failed = problem.answers(z, rng).failed
    rate = weighted_rate(failed, Normal(problem.dimension).log_density(z))
    assert rate is not None
    return rate.rate, rate.low, rate.high


class Outcome(NamedTuple):
    """What a run found: a probability with its interval, both NaN where it gave none."""

    probability: float
    low: float
    high: float
    refused: bool
    queries: int


def now(number: int, problem: Problem, seed: int) -> Outcome:
    """Estimate a problem's probability as `sada-gym estimate` does."""
    rng, noise = (np.random.default_rng((number, seed, *more)) for more in ((), (1,)))
    found = estimate_probability(
        Normal(problem.dimension), lambda z, _: problem.answers(z, noise), 0.5, QUERIES, rng
    )
    return Outcome(found.probability, *found.interval, found.refused is not None, QUERIES)


def plain(number: int, problem: Problem, seed: int) -> Outcome:
    """Count plain draws."""
    rng, noise = (np.random.default_rng((number, seed, stream)) for stream in (3, 1))
    failed = problem.answers(rng.normal(size=(QUERIES, problem.dimension)), noise).failed
    interval = exact_interval(int(failed.sum()), QUERIES)
    return Outcome(float(failed.mean()), *interval, False, QUERIES)


Method = Callable[[int, Problem, int], Outcome]
"""Estimates by the number of a problem, the problem, and a seed."""

Runs = dict[tuple[str, int], list[Outcome]]
"""The runs of each method on each problem's number, by seed."""


def in_rounds(
    methods: dict[str, Method],
    numbers: Sequence[int],
    runs: int,
    store: Path | None = None,
    seconds: float = np.inf,
) -> Runs:
    """Run each method on each problem once a round, and return whole rounds.

    `store` keeps what was found, and is not asked again for what it holds. After so many seconds of
    the processor no round begins.
    """
    done: dict[tuple[str, int, int], Outcome] = {}
    if store is not None and store.exists():
        with store.open(newline="") as file:
            for name, number, seed, *told, refused, queries in csv.reader(file):
                outcome = Outcome(*map(float, told), refused == "True", int(queries))
                done[name, int(number), int(seed)] = outcome
    every, found = problems(), Runs()
    for seed in range(runs):
        if time.process_time() > seconds:
            break
        for name, method in methods.items():
            for number in numbers:
                if (name, number, seed) not in done:
                    outcome = method(number, every[number], seed)
                    done[name, number, seed] = outcome
                    if store is not None:
                        with store.open("a", newline="") as file:
                            csv.writer(file).writerow((name, number, seed, *outcome))
                found.setdefault((name, number), []).append(done[name, number, seed])
    return found


def row(problem: Problem, runs: Sequence[Outcome]) -> Iterator[str]:
    """Yield the cells of a problem's row."""
    plain = np.sqrt((1.0 - problem.truth) / problem.truth / QUERIES)
    old = np.array([before(problem, seed) for seed in range(BEFORE_RUNS)])
    new = np.array([one[:3] for one in runs])
    sure = np.array([not one.refused for one in runs])
    yield f"{problem.name}"
    yield f"{problem.dimension}"
    yield f"{problem.truth:.1e}"
    yield f"{plain:.2f}"
    yield short(error(old, problem.truth), 2)
    yield f"{100 * held(old, problem.truth).mean():.0f} %"
    yield f"{short(upper(old, problem.truth), 1)} p"
    yield f"{error(new, problem.truth):.2f}"
    yield coverage(held(new[sure], problem.truth))
    yield f"{upper(new, problem.truth):.1f} p"
    yield f"{int((~sure).sum())} of {len(runs)}"


def short(value: float, digits: int) -> str:
    """Write a number with so many decimals, and one of 10 or more without any."""
    return f"{value:,.0f}" if value >= 10.0 else f"{value:.{digits}f}"


def coverage(held: npt.NDArray[np.bool_]) -> str:
    """Write which share of intervals hold the truth, (n,), with its own 95 % interval."""
    if not len(held):
        return "-"
    low, high = (100 * end for end in wilson_interval(int(held.sum()), len(held)))
    return f"{100 * held.mean():.0f} % ({low:.0f} to {high:.0f})"


def error(found: Floats, truth: float) -> float:
    """Return the relative error, root mean square, of (n, 3) rates with their intervals."""
    return float(np.sqrt(np.mean((found[:, 0] / truth - 1.0) ** 2)))


def held(found: Floats, truth: float) -> npt.NDArray[np.bool_]:
    """Return which of (n, 3) rates with their intervals hold the truth, (n,)."""
    return np.asarray((found[:, 1] <= truth) & (truth <= found[:, 2]))


def upper(found: Floats, truth: float) -> float:
    """Return the median of the upper ends of (n, 3) rates with their intervals, by the truth."""
    return float(np.median(found[:, 2]) / truth)


def numbers_of(half: str) -> list[int]:
    """Return the numbers of the problems of a half."""
    chosen = range(len(problems()))
    return [number for number in chosen if half in ("both", ("choose", "judge")[number % 2])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=("choose", "judge", "both"), default="both")
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--minutes", type=float, default=np.inf, help="of the processor, at most")
    parser.add_argument("--store", type=Path, help="a file that keeps the runs")
    given = parser.parse_args()
    numbers = numbers_of(given.half)
    found = in_rounds({"now": now}, numbers, given.runs, given.store, 60.0 * given.minutes)
    columns = ["problem", "d", "p", "plain: error", "weighted uniform: error"]
    columns += ["held", "upper", "estimate: error", "held", "upper"]
    print("|", " | ".join([*columns, "refused"]), "|")
    print("| --- " * (len(columns) + 1) + "|")
    for number in numbers:
        print("|", " | ".join(row(problems()[number], found["now", number])), "|", flush=True)


if __name__ == "__main__":
    main()
