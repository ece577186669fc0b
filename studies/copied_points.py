"""How well the verifier tells copied reference points from honest samples.

    python -m studies.copied_points power
    python -m studies.copied_points entries
    python -m studies.copied_points adversaries SADA-Analytic-v0 SADA-Detection-Car-v0

`power` shakes fooling points of the shipped sets. `entries` measures the samples of all entries of
the board. `adversaries` trains adversaries with few queries, on a track without a shipped set
against the points that one would have.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from contextlib import closing
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from sada_gym import adversaries
from sada_gym.board.results.entry import read_entries
from sada_gym.board.submission.flags import is_near, nearness
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluation.problems import make_application
from sada_gym.experiment.ideal import IDEAL
from sada_gym.foundations.cards import find_card
from sada_gym.measures.reference import load_reference, reference_mu
from sada_gym.parameters import Mu

TRACKS = (
    *("SADA-Digits-0-v0", "SADA-Detection-Car-v0", "SADA-Driving-OneCurve-v0"),
    *("SADA-UAV-3Anchors-v0", "SADA-Robot-Warehouse-v0"),
)
ADVERSARIES = (
    *("random", "memorise", "svm", "gp", "gaussian", "gmm50", "bayesian", "bbgan:paper"),
    *("bbgan", "cross-entropy", "smc", "cma-mae", "trees", "level-set"),
)
JITTERS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
REPEATS = 20


def shaken(points: Mu, count: int, length: float, rng: np.random.Generator) -> Mu:
    """Draw points and move each by a length in a random direction."""
    drawn = points[rng.choice(len(points), count, replace=len(points) < count)].astype(np.float64)
    step = rng.standard_normal(drawn.shape)
    step *= length / np.linalg.norm(step, axis=1, keepdims=True)
    return np.clip(drawn + step, -1.0, 1.0).astype(np.float32)


def spacing(points: Mu) -> float:
    """Return the median distance from a point to its nearest other one."""
    array = points.astype(np.float64)
    return float(np.median(cKDTree(array).query(array[:1_000], k=2)[0][:, 1]))


def power() -> None:
    print(f"| track | d | M | spacing | {' | '.join(map(str, JITTERS))} | half copied |")
    print("| --- " * (len(JITTERS) + 5) + "|")
    for track in TRACKS:
        with closing(make_application(track)) as application:
            reference = load_reference(track, application)
        assert reference is not None
        count, inside = application.sample_size, reference.fooling_set
        unit, cells = spacing(reference.mu), []
        for jitter in (*JITTERS, None):
            flagged = 0
            for repeat in range(REPEATS):
                rng = np.random.default_rng(repeat)
                mu = shaken(inside, count, (jitter or 0.0) * unit, rng)
                if jitter is None:  # the others are drawn where the copies are, but far from them
                    mu = np.concatenate(
                        [
                            shaken(inside, count // 2, 0.25 * unit, rng),
                            shaken(inside, count // 2, 2.0 * unit, rng),
                        ]
                    )
                flagged += is_near(nearness(mu, reference.mu, seed=repeat))
            cells.append(f"{100 * flagged / REPEATS:.0f}")
        dimension = reference.mu.shape[1]
        print(f"| {track} | {dimension} | {count} | {unit:.3f} | {' | '.join(cells)} |", flush=True)


def of_entries(folder: Path) -> None:
    results = defaultdict(list)
    for entry in read_entries(folder):
        for result in entry.results.values():
            experiment = result.experiment
            application = experiment.target.application.name
            card = find_card(application)
            if experiment.adversary.name == IDEAL or card is None:
                continue
            if experiment.target.reference is None:
                continue
            for samples in result.samples.values():
                mu = samples.mu
                points = reference_mu(mu.shape[1], card.reference_points, card.sobol_seed)
                results[application, entry.metadata.name].append(nearness(mu, points))
    report(results)


def of_adversaries(tracks: list[str], budget: int) -> None:
    results = defaultdict(list)
    for track in tracks:
        with closing(Evaluator(track)) as evaluator:
            assert evaluator.application is not None
            card = find_card(evaluator.application.name)
            assert card is not None
            points = reference_mu(evaluator.dimension, card.reference_points, card.sobol_seed)
            for name in ADVERSARIES:
                name, _, preset = name.partition(":")
                options = {"preset": preset} if preset else {}
                solver = adversaries.make(name, evaluator.dimension, seed=0, **options)
                solver.train(Oracle(evaluator, budget=budget, seed=0))
                mu = np.asarray(solver.sample(evaluator.application.sample_size), np.float32)
                results[track, f"{name} {preset}"].append(nearness(mu, points))
                print("  ", track, name, preset, results[track, f"{name} {preset}"][-1], flush=True)
    report(results)


def report(results: dict) -> None:
    print("| where | adversary | runs | flagged | with 10 points | least mean rank | least p |")
    print("| --- " * 7 + "|")
    for (where, name), runs in results.items():
        enough = [run for run in runs if run.points >= 10]
        least = f"{min(run.mean_rank for run in enough):.2f}" if enough else "-"
        p = f"{min(run.p for run in enough):.0e}" if enough else "-"
        flagged = sum(map(is_near, runs))
        cells = (where, name, len(runs), flagged, len(enough), least, p)
        print(f"| {' | '.join(map(str, cells))} |")
    every = [run for runs in results.values() for run in runs]
    print(f"{sum(map(is_near, every))} of {len(every)} are flagged")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("power", "entries", "adversaries"))
    parser.add_argument("tracks", nargs="*")
    parser.add_argument("--budget", type=int, default=1_000)
    parser.add_argument("--entries", type=Path, default=Path("leaderboard/entries"))
    arguments = parser.parse_args()
    if arguments.what == "power":
        power()
    elif arguments.what == "entries":
        of_entries(arguments.entries)
    else:
        of_adversaries(arguments.tracks, arguments.budget)


if __name__ == "__main__":
    main()
