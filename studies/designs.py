"""Compare designs of adversaries on training tracks: how the defaults were chosen.

    python -m studies.designs --family level-set --seeds 2
    python -m studies.designs --family rl --seeds 2

The tracks are analytic boxes and synthetic landscapes with a random world: of `waves-P` P % of
uniform mu fool, and of `luck-5` five, which mostly do not fool again. In `smooth-D-I-O` and
`spots-D-I-O` nothing but luck decides: I % of the mu in the fooling set fool, O % elsewhere, in D
dimensions (`lucky_landscapes.py`). The family `level-set` has more: two detection classes (car and
chair, which are training tracks for that reason) with both agents, and images of the digits 0 to 4.
`digits-D-K` is the first test image of the digit K that D parameters can harm, with the threshold
at the lowest tenth of its scores, which often lies at 1e-4. The digits 5 to 9 are held out:

    python -m studies.designs --designs --adversaries level-set trees --budget 1000 --samples 250 \\
        --tracks digits-{2,3,4,6}-{5,6,7,8,9} --seeds 3

What depends on the scale of Q: `digits-D-K:power` has Q^4 for Q, `:log` log Q, `:rank` its rank.

    python -m studies.designs --designs --adversaries gp cma-mae level-set \
        --tracks digits-2-1{,:power,:log,:rank} --budget 1000 --samples 250

Each design learns from N = 2,000 queries. Then 500 samples are held against points that it never
saw:

- AFR: the samples' true fooling rate, in %; on detection the rate of fresh evaluations.
- coverage (Naeem et al. 2020, k = 5): the share of held-out points of the fooling set
  {mu: P(Q <= threshold) >= 0.5} that have a fooling sample within the distance to their fifth
  nearest neighbour; as a share of what as many ideal samples (uniform over the set) reach.

The criterion is the mean over tracks and seeds of AFR / ideal samples' AFR x coverage, each factor
at most 1: a design has to fool, and to cover.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import adversaries
from sada_gym.adversaries.base import Query
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import fools
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.reference import load_reference
from sada_gym.testing.scales import scales
from studies.landscapes import THRESHOLD, FunctionOracle, Landscape
from studies.lucky_landscapes import LuckyLandscape

PLAIN: dict[str, Any] = {"starts": "centre", "dissimilarity": 0.0}
NO_BONUS: dict[str, Any] = {"starts": "uniform", "dissimilarity": 0.0}
BONUS: dict[str, Any] = {"starts": "uniform", "dissimilarity": 0.5}
NO_HITS: dict[str, Any] = {"trial": 0.0}
"""Most designs of `level-set` were compared before it tried hits."""
WIDE: dict[str, Any] = {**PLAIN, "log_deviation": 0.0}

DESIGNS: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {
    "bbgan": {
        "random": ("random", {}),
        "paper preset": ("bbgan", {"preset": "paper"}),
        "paper preset, boosted": ("bbgan-boost", {"preset": "paper"}),
        "**default**": ("bbgan", {}),
        "without the rest of Omega": ("bbgan", {"rest": 0.0}),
        "without a tether": ("bbgan", {"tether": 0.0}),
        "without Fourier features": ("bbgan", {"features": 0}),
        "G of z alone (no transport)": ("bbgan", {"transport": False, "tether": 0.0}),
        "without refusals": ("bbgan", {"acceptance": 0.0}),
        "s = 100": ("bbgan", {"induced_size": 100}),
        "**default, boosted**": ("bbgan-boost", {}),
    },
    "rl": {
        "random": ("random", {}),
        "reinforce, one Gaussian": (
            "reinforce",
            {"components": 1, "deviation": 1.0, "entropy": 0.0, "dissimilarity": 0.0},
        ),
        "reinforce, no entropy, no bonus": ("reinforce", {"entropy": 0.0, "dissimilarity": 0.0}),
        "reinforce, entropy 0.05": ("reinforce", {"entropy": 0.05, "dissimilarity": 0.0}),
        "reinforce, entropy 0.1": ("reinforce", {"entropy": 0.1, "dissimilarity": 0.0}),
        "reinforce, bonus 0.3": ("reinforce", {"entropy": 0.0, "dissimilarity": 0.3}),
        "reinforce, entropy 0.05, bonus 0.3": (
            "reinforce",
            {"entropy": 0.05, "dissimilarity": 0.3},
        ),
        "reinforce, entropy 0.1, bonus 0.3": ("reinforce", {"entropy": 0.1, "dissimilarity": 0.3}),
        "ppo, one start": ("ppo", {**WIDE, "entropy": 0.0}),
        "ppo, one start, entropy 0.05": ("ppo", {**WIDE, "entropy": 0.05}),
        "ppo, one start, bonus 0.5": ("ppo", {**WIDE, "entropy": 0.0, "dissimilarity": 0.5}),
        "ppo, uniform starts": ("ppo", {**NO_BONUS, "entropy": 0.0}),
        "ppo, uniform starts, entropy 0.01": ("ppo", {**NO_BONUS, "entropy": 0.01}),
        "ppo, uniform starts, bonus 0.5": ("ppo", {**BONUS, "entropy": 0.0}),
        "ppo, uniform starts, both": ("ppo", {**BONUS, "entropy": 0.01}),
        "sac, one start, entropy 0.05": ("sac", {**PLAIN, "entropy": 0.05}),
        "sac, one start, bonus 0.5": ("sac", {**PLAIN, "entropy": 0.05, "dissimilarity": 0.5}),
        "sac, uniform starts, entropy 0.02": ("sac", {**NO_BONUS, "entropy": 0.02}),
        "sac, uniform starts, entropy 0.05": ("sac", {**NO_BONUS, "entropy": 0.05}),
        "sac, uniform starts, entropy 0.02, bonus 0.5": ("sac", {**BONUS, "entropy": 0.02}),
        "sac, uniform starts, entropy 0.05, bonus 0.5": ("sac", {**BONUS, "entropy": 0.05}),
        "td3, one start, noise 0.1": ("td3", {**PLAIN, "noise": 0.1}),
        "td3, one start, bonus 0.5": ("td3", {**PLAIN, "noise": 0.1, "dissimilarity": 0.5}),
        "td3, uniform starts, noise 0.05": ("td3", {**NO_BONUS, "noise": 0.05}),
        "td3, uniform starts, noise 0.1": ("td3", {**NO_BONUS, "noise": 0.1}),
        "td3, uniform starts, noise 0.1, bonus 0.5": ("td3", {**BONUS, "noise": 0.1}),
    },
    "level-set": {
        "**default**": ("level-set", {}),
        "hits alone": ("level-set", {"beside": 1.0}),
        "no hits": ("level-set", NO_HITS),
        "mutual information": ("studies.acquisitions:MutualInformation", NO_HITS),
        "straddle": ("studies.acquisitions:Straddle", NO_HITS),
        "own samples, a quarter": ("studies.acquisitions:Own", NO_HITS),
        "own samples, half": ("studies.acquisitions:OwnHalf", NO_HITS),
        "own samples, last round": ("studies.acquisitions:OwnLast", NO_HITS),
        "no informative queries": ("level-set", {**NO_HITS, "rounds": 0}),
        "a quarter uniform": ("level-set", {**NO_HITS, "uniform": 0.25}),
        "eight rounds": ("level-set", {**NO_HITS, "rounds": 8}),
        "no uniform share in a round": ("level-set", {**NO_HITS, "explore": 0.0}),
        "trees alone": ("level-set", {**NO_HITS, "models": ["trees"]}),
        "Gaussian process alone": ("level-set", {**NO_HITS, "models": ["process"]}),
        "level 1/2": ("level-set", {**NO_HITS, "coverage": 1.0}),
        "coverage 0.95": ("level-set", {**NO_HITS, "coverage": 0.95}),
        "no least volume": ("level-set", {**NO_HITS, "volume": 0.0}),
        "a quarter of the volume": ("level-set", {**NO_HITS, "volume": 0.25}),
        "half of the volume": ("level-set", {**NO_HITS, "volume": 0.5}),
        "extra-trees, rejection": ("trees", {}),
    },
}
_SIMPLE = ("boxes-2", "boxes-5", "boxes-8", "waves-35", "waves-20")
TRACKS = {
    "bbgan": _SIMPLE,
    "rl": _SIMPLE,
    "level-set": (
        *(*_SIMPLE, "boxes-16", "waves-8", "waves-4", "waves-2", "luck-5"),
        *("digits-2-0", "digits-2-1", "digits-3-2", "digits-4-3", "digits-6-4"),
        *("Car", "Chair", "Car:surveyor", "Chair:surveyor"),
    ),
}

Mu = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Track:
    """A problem whose truth is known.

    Attributes:
        dimension: d.
        oracle: Makes an oracle, for a seed and a budget.
        rate: Fooling rates of mu (n, d): true ones, or 0 and 1 of one evaluation each.
        fooling_set: Held-out points of it.
        ideal_rate: Mean fooling rate of its points.
    """

    dimension: int
    oracle: Callable[[int, int], Query]
    rate: Callable[[Mu], npt.NDArray[np.float64]]
    fooling_set: Mu
    ideal_rate: float


def analytic(
    dimension: int,
    make: Callable[[], Callable[[Any], Any]],
    rate: Callable[[Mu], npt.NDArray[np.float64]],
    threshold: float = THRESHOLD,
) -> Track:
    uniform = np.random.default_rng(12345).uniform(-1.0, 1.0, (60_000, dimension))
    mu = uniform.astype(np.float32)
    rates = rate(mu)
    inside = rates >= 0.5
    return Track(
        dimension,
        lambda seed, budget: FunctionOracle(make(), budget, threshold),  # noqa: ARG005
        rate,
        mu[inside],
        float(rates[inside].mean()),
    )


def boxes(dimension: int) -> Track:
    application = AnalyticApplication(dimension=dimension)

    def score(mu: Mu) -> npt.NDArray[np.float64]:
        return application.evaluate(mu, range(len(mu))).score

    def rate(mu: Mu) -> npt.NDArray[np.float64]:
        return (application.fooling_region(mu) >= 0).astype(np.float64)

    return analytic(dimension, lambda: score, rate)


def waves(percent: int) -> Track:
    seed = {35: 0, 20: 1, 8: 2, 4: 3, 2: 4}[percent]
    return landscape(lambda: Landscape(seed, rate=percent / 100))


def landscape(make: Callable[[], Landscape]) -> Track:
    return analytic(8, make, make().fooling_rate)


def lucky(shape: str, dimension: int, inside: int, outside: int) -> Track:
    def make() -> LuckyLandscape:
        return LuckyLandscape(
            0, shape=shape, dimension=dimension, inside=inside / 100, outside=outside / 100
        )

    return analytic(dimension, make, make().fooling_rate)


def detection(object_class: str, agent: str | None, workers: int) -> Track:
    track = f"SADA-Detection-{object_class}-v0"
    evaluator = Evaluator(track, env_kwargs={"agent": agent} if agent else {}, workers=workers)
    assert evaluator.application is not None
    reference = load_reference(track, evaluator.application)
    if reference is None:
        raise ValueError(f"Expected a reference set of {track}; make it with reference_sets.py.")

    def rate(mu: Mu) -> npt.NDArray[np.float64]:
        test = Oracle(evaluator, budget=len(mu), seed=0, stream="test")
        return fools(test(mu), test.threshold).astype(np.float64)

    rows = np.random.default_rng(0).choice(len(reference.fooling_set), 500)
    return Track(
        8,
        lambda seed, budget: Oracle(evaluator, budget=budget, seed=seed),
        rate,
        reference.fooling_set,
        float(rate(reference.fooling_set[rows]).mean()),
    )


def digits(dimension: int, digit: int, scale: str) -> Track:
    """The first test image of a digit of which a tenth of the box leaves Q below 0.95.

    The adversary sees Q on another scale, and the threshold with it; the truth is the same.
    """
    names = DigitsApplication().parameters.names[:dimension]
    uniform = np.random.default_rng(54321).uniform(-1.0, 1.0, (20_000, dimension))
    for image in DigitsApplication(digit=digit).indices.tolist():
        application = DigitsApplication(image=image, parameters=names)

        def score(mu: Mu, application: DigitsApplication = application) -> npt.NDArray[np.float64]:
            return application.evaluate(mu, [0] * len(mu)).score

        threshold = float(np.quantile(score(uniform.astype(np.float32)), 0.1))
        if threshold < 0.95:
            break
    else:
        raise ValueError(f"Expected {dimension} parameters that can harm the digit {digit}.")

    def rate(mu: Mu) -> npt.NDArray[np.float64]:
        return fools(score(mu), threshold).astype(np.float64)

    index = ("", "power", "log", "rank").index(scale)
    scaled = scales(score(uniform.astype(np.float32)))[index].map
    return analytic(dimension, lambda: lambda mu: scaled(score(mu)), rate, float(scaled(threshold)))


def load(name: str, workers: int) -> Track:
    kind, _, number = name.partition("-")
    if kind == "digits":
        number, _, scale = number.partition(":")
        dimension, _, digit = number.partition("-")
        return digits(int(dimension), int(digit), scale)
    if kind == "boxes":
        return boxes(int(number))
    if kind == "waves":
        return waves(int(number))
    if kind == "luck":
        return landscape(lambda: Landscape(5, rate=int(number) / 100, noise=1.0))
    if kind in ("smooth", "spots"):
        return lucky(kind, *map(int, number.split("-")))
    object_class, _, agent = name.partition(":")
    return detection(object_class, agent or None, workers)


def measure(track: Track, mu: Mu, rng: np.random.Generator) -> tuple[float, float]:
    """Return AFR and coverage of samples."""
    rate = track.rate(mu)
    fooled = rng.random(len(mu)) < rate
    return float(rate.mean()), fooling_coverage(mu, fooled, track.fooling_set).coverage


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--family", choices=list(DESIGNS), default="level-set")
    parser.add_argument("--designs", nargs="*", help="some of the family's")
    parser.add_argument("--adversaries", nargs="*", default=[], help="by name, beside them")
    parser.add_argument("--tracks", nargs="*")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--budget", type=int, default=2_000)
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    designs = DESIGNS[chosen.family]
    if chosen.designs is not None:
        designs = {name: designs[name] for name in chosen.designs}
    designs |= {name: (name, {}) for name in chosen.adversaries}
    names = chosen.tracks or TRACKS[chosen.family]
    problems = {name: load(name, chosen.workers) for name in names}
    print("| design |", *(f"{name} |" for name in names), "criterion | s a training |")
    print("| --- |", *("--- |" for _ in names), "--- | --- |")
    coverages = {}
    cells = []
    for name, track in problems.items():
        rng = np.random.default_rng(99)
        draws = []
        for _ in range(4):
            rows = rng.choice(len(track.fooling_set), chosen.samples)
            fooled = rng.random(chosen.samples) < track.ideal_rate
            mu = track.fooling_set[rows]
            draws.append(fooling_coverage(mu, fooled, track.fooling_set).coverage)
        coverages[name] = float(np.mean(draws))
        cells.append(f"{100 * track.ideal_rate:.0f} / 1.00 |")
    print("| ideal samples |", *cells, "1.00 | |", flush=True)
    for design, (kind, options) in designs.items():
        cells, merits, seconds = [], [], 0.0
        for name, track in problems.items():
            figures = []
            for seed in range(chosen.seeds):
                adversary = adversaries.make(kind, track.dimension, seed=seed, **options)
                start = time.process_time()
                adversary.train(track.oracle(seed, chosen.budget))
                seconds += time.process_time() - start
                mu = adversary.sample(chosen.samples)
                afr, coverage = measure(track, mu, np.random.default_rng(seed))
                figures.append((afr, coverage / coverages[name]))
                merits.append(min(afr / track.ideal_rate, 1.0) * min(figures[-1][1], 1.0))
            afr, coverage = np.mean(figures, axis=0)
            cells.append(f"{100 * afr:.0f} / {coverage:.2f} |")
        print(
            f"| {design} |",
            *cells,
            f"{np.mean(merits):.2f} | {seconds / len(merits):.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
