"""How many points and seeds a reference set needs.

    python -m studies.reference_seeds luck
    python -m studies.reference_seeds coverage SADA-Digits-0-v0 --seeds 64
    python -m studies.reference_seeds coverage SADA-Detection-Car-v0

`luck` needs the shipped sets alone. A set of k seeds holds what fooled on at least half of them.
From each set's counts it estimates how the points' true rates are distributed (maximum likelihood
of a mixture of binomials), and from that what k seeds would let in and miss.

`coverage` takes a track's points, evaluated on many seeds (`--seeds`) or as often as in the shipped
set. Each repetition splits the points and the seeds of each point into two: two reference sets that
share neither. Half the mean squared difference of a figure is then its variance over the choice of
points and of seeds, without bias. The samples that are measured stay the same: uniform ones, what a
uniform search found, the part of that in one half of the box, and those of the board's entries. The
ideal samples alone are drawn anew. A cell holds coverage, its 95 % interval and relative coverage.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.application import Application
from sada_gym.board.results.entry import read_entry
from sada_gym.evaluation.problems import make_application
from sada_gym.evaluations import evaluation_seeds
from sada_gym.foundations.registration import tracks
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.reference import Reference, load_reference, reference_mu
from sada_gym.parameters import Mu

SEEDS = (1, 2, 3, 4, 5, 8)
POINTS = (2_000, 5_000, 10_000, 20_000)
GRID = np.linspace(0.0, 1.0, 202)  # even: no rate is exactly 1/2
STEPS = 2_000
REPEATS = 20
SOBOL_SEED = 2020
SEARCHED = 6_000
CHUNK = 250
ENTRIES = Path("leaderboard/entries")
BOARD = ("level-set", "bayesian")

Counts = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.float64]


def binomial(seeds: int) -> Numbers:
    """P(c of k seeds fool) for each rate of the grid, (grid, k + 1)."""
    from scipy.stats import binom

    likelihood: Numbers = binom.pmf(np.arange(seeds + 1)[None], seeds, GRID[:, None])
    return likelihood


def rates_from(counts: Counts, seeds: int) -> Numbers:
    """Estimate the distribution of the points' rates by expectation maximisation, (grid,)."""
    likelihood = binomial(seeds)
    seen = np.bincount(counts, minlength=seeds + 1) / len(counts)
    weights = np.full(len(GRID), 1.0 / len(GRID))
    for _ in range(STEPS):
        weights = weights * (likelihood @ (seen / (weights @ likelihood)))
    return weights


def luck_of(weights: Numbers, seeds: int) -> tuple[float, float, float]:
    """What k seeds give: the share of the set by luck, of truly fooling missed, the set's rate."""
    inside = binomial(seeds)[:, -(-seeds // 2) :].sum(axis=1)
    inner, truly = weights * inside, GRID > 0.5
    by_luck = inner[~truly].sum() / inner.sum()
    missed = 1.0 - inner[truly].sum() / weights[truly].sum()
    return float(by_luck), float(missed), float((inner * GRID).sum() / inner.sum())


def luck() -> None:
    print("| track | agent | seeds of the set | " + " | ".join(map(str, SEEDS)) + " |")
    print("| --- " * (len(SEEDS) + 3) + "|")
    for track in tracks(installed=True):
        for agent in agents.names(make_application(track).name):
            reference = load_reference(track, make_application(track, agent=agent))
            if reference is not None:
                print(luck_row(track, agent, reference))


def luck_row(track: str, agent: str, reference: Reference) -> str:
    seeds = reference.entry.seeds
    weights = rates_from(reference.fooled.astype(np.int64), seeds)
    cells = (" / ".join(f"{100 * x:.0f}" for x in luck_of(weights, k)) for k in SEEDS)
    return f"| {track} | {agent} | {seeds} | {' | '.join(cells)} |"


@functools.cache
def application(track: str, agent: str) -> Application:
    return make_application(track, agent=agent)


def fooled_on(track: str, agent: str, mu: Mu, seeds: list[int]) -> npt.NDArray[np.bool_]:
    """Return which worlds fool the agent, (n,)."""
    fooled: npt.NDArray[np.bool_] = application(track, agent).evaluate(mu, seeds).fooled
    return fooled


def counted(track: str, agent: str, points: int, seeds: int, cache: Path) -> tuple[Mu, Counts]:
    """Return points, and on how many new seeds each of them fools; a file keeps the counts."""
    mu = reference_mu(len(application(track, agent).parameters), points, SOBOL_SEED)
    path = cache / f"{track}-{agent}-{points}-{seeds}.npy"
    if not path.exists():
        every = evaluation_seeds(1, "validation", 0, points * seeds)
        fooled = fooled_on(track, agent, np.repeat(mu, seeds, axis=0), every)
        cache.mkdir(parents=True, exist_ok=True)
        np.save(path, fooled.reshape(points, seeds).sum(axis=1))
    return mu, np.load(path).astype(np.int64)


def fixed_samples(
    track: str, agent: str, samples: int | None
) -> dict[str, tuple[Mu, npt.NDArray[np.bool_]]]:
    """Draw the samples that are measured, M of each kind: mu and which of them fool."""
    opened = application(track, agent)
    size, dimension = samples or opened.sample_size, len(opened.parameters)
    box = np.random.default_rng(1).uniform(-1, 1, (SEARCHED, dimension)).astype(np.float32)
    known: list[npt.NDArray[np.bool_]] = []
    in_half = box[:, 0] > 0.0
    for start in range(0, SEARCHED, CHUNK):
        seeds = evaluation_seeds(1, "train", start, min(CHUNK, SEARCHED - start))
        known.append(fooled_on(track, agent, box[start : start + len(seeds)], seeds))
        fooled = np.concatenate(known)
        if (fooled & in_half[: len(fooled)]).sum() >= size:
            break
    fooling, half = (box[: len(fooled)][rows] for rows in (fooled, fooled & in_half[: len(fooled)]))
    chosen = {"uniform": box[-size:], "found": fooling[:size], "found, half": half[:size]}
    for name in BOARD:
        for result in read_entry(ENTRIES / name).results.values():
            target = result.experiment.target
            if (target.track, target.agent) == (track, agent):
                chosen[name] = result.samples[0].mu[:size]
    return {
        name: (mu, fooled_on(track, agent, mu, evaluation_seeds(1, "test", 0, len(mu))))
        for name, mu in chosen.items()
    }


def coverages(
    mu: Mu,
    pair: tuple[Counts, Counts],
    to_cover: npt.NDArray[np.bool_],
    seeds: int,
    fixed: dict[str, tuple[Mu, npt.NDArray[np.bool_]]],
    rng: np.random.Generator,
) -> list[float]:
    """Measure the coverage of ideal samples and of each kind by one half of the points.

    The ideal samples come from the other half; the other seeds say which of them fool.
    """
    count, others = pair
    inside = 2 * count >= seeds
    measured, drawn = mu[inside & to_cover], np.flatnonzero(inside & ~to_cover)
    size = len(next(iter(fixed.values()))[0])
    ideal = rng.choice(drawn, min(size, len(drawn)), replace=False)
    fools = rng.random(len(ideal)) < others[ideal] / seeds
    best = fooling_coverage(mu[ideal], fools, measured).coverage
    return [best, *(fooling_coverage(*pair, measured).coverage for pair in fixed.values())]


def spread(
    mu: Mu,
    counts: Counts,
    total: int,
    points: int,
    seeds: int,
    fixed: dict[str, tuple[Mu, npt.NDArray[np.bool_]]],
) -> tuple[Numbers, Numbers]:
    """Return mean and standard deviation over choices of points and seeds, (1 + kinds,) each."""
    rng = np.random.default_rng(0)
    pairs = []
    for _ in range(REPEATS):
        start = points * rng.integers(len(mu) // points)
        rows = slice(start, start + points)
        first = rng.hypergeometric(counts[rows], total - counts[rows], seeds)
        second = rng.hypergeometric(
            counts[rows] - first, total - counts[rows] - (seeds - first), seeds
        )
        half = rng.permutation(points) < points // 2
        pairs.append(
            [
                coverages(mu[rows], pair, to_cover, seeds, fixed, rng)
                for pair, to_cover in (((first, second), half), ((second, first), ~half))
            ]
        )
    figures = np.array(pairs)  # (repetitions, 2, figures)
    variance = ((figures[:, 0] - figures[:, 1]) ** 2).mean(axis=0) / 2
    return figures.mean(axis=(0, 1)), np.sqrt(variance)


def check_by_others(counts: Counts, total: int) -> None:
    """Print what sets of k seeds hold, judged by the seeds that they leave out."""
    for k in (k for k in SEEDS if 4 * k <= total):
        first = np.random.default_rng(0).hypergeometric(counts, total - counts, k)
        inside, others = 2 * first >= k, (counts - first) / (total - k)
        by_luck, missed = (others[inside] < 0.5).mean(), (~inside[others >= 0.5]).mean()
        rates = (inside.mean(), by_luck, missed, others[inside].mean())
        cells = " | ".join(f"{100 * rate:.0f} %" for rate in rates)
        print(f"| {k} of {total} seeds | {cells} |")


def coverage(
    track: str, agent: str, mu: Mu, counts: Counts, total: int, samples: int | None
) -> None:
    print(f"\n{track}, {agent}: {len(mu)} points, {total} seeds each")
    print("| seeds | in the set | of these by luck | missed | their rate |\n" + "| --- " * 5 + "|")
    check_by_others(counts, total)
    fixed = fixed_samples(track, agent, samples)
    kinds = ["ideal", *(f"{kind} ({of[1].mean():.2f})" for kind, of in fixed.items())]
    print(f"| points | seeds | {' | '.join(kinds)} |\n" + "| --- " * (len(kinds) + 2) + "|")
    for points in (p for p in POINTS if p <= len(mu)):
        for k in (k for k in SEEDS if 2 * k <= total):
            means, deviations = spread(mu, counts, total, points, k, fixed)
            row = " | ".join(
                f"{mean:.3f} ± {1.96 * sd:.3f} ({mean / means[0]:.2f})"
                for mean, sd in zip(means, deviations, strict=True)
            )
            print(f"| {points} | {k} | {row} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("luck", "coverage"))
    parser.add_argument("track", nargs="?")
    parser.add_argument("--agents", nargs="*", help="all of the track's by default")
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, help="evaluate so many; by default the shipped set's")
    parser.add_argument("--samples", type=int, help="M; by default the track's")
    parser.add_argument("--work", type=Path, default=Path("runs/reference-seeds"))
    given = parser.parse_args()
    if given.what == "luck":
        luck()
        return
    if given.track is None:
        parser.error("coverage needs a track")
    for agent in given.agents or agents.names(make_application(given.track).name):
        if given.seeds is not None:
            total = given.seeds
            mu, counts = counted(given.track, agent, given.points, total, given.work)
        else:
            reference = load_reference(given.track, make_application(given.track, agent=agent))
            if reference is None:
                parser.error(f"{given.track} has no reference set for {agent}: give --seeds")
            total, mu, counts = reference.entry.seeds, reference.mu, reference.fooled.astype(int)
        coverage(given.track, agent, mu, counts, total, given.samples)


if __name__ == "__main__":
    main()
