"""Does an adversary learn the same from Q, Q^4, log Q and the rank of Q? Measured on digits.

    OMP_NUM_THREADS=1 python -m studies.scale --record runs/scale.jsonl

Each adversary learns from 1,000 queries on each scale and draws 250 samples. They are judged by Q
itself on worlds of their own: AFR in %, and coverage as a share of ideal samples'. The threshold is
mapped as the scores are, so the same worlds fool on every scale.

An adversary keeps the contract on a seed if it does what `AdversaryContract` asks on the analytic
boxes: the four 95 % intervals of the AFR overlap, and the four coverages lie within 0.1. `=` says
that a scale gave the same samples as Q on every seed, to the last bit.

`--record` names a file that keeps each training's figures. The same command goes on from there.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import adversaries, make_application
from sada_gym.application import Application
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import fools
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.measures.reference import load_reference
from sada_gym.testing.scales import Scale, scales

TRACK = "SADA-Digits-3-v0"
BUDGET, SAMPLES, UNIFORM = 1_000, 250, 5_000
FARTHEST = 0.1
"""How far coverages on two scales may lie apart: as far as in the contract."""

Mu = npt.NDArray[np.float32]


class ScaledOracle:
    """An oracle whose scores and threshold are mapped to another scale."""

    def __init__(self, oracle: Oracle, scale: Scale) -> None:
        self._oracle, self._scale = oracle, scale
        self.threshold = float(scale.map(oracle.threshold))
        self.permits = oracle.permits

    @property
    def remaining(self) -> int:
        return self._oracle.remaining

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        return np.asarray(self._scale.map(self._oracle(mu)), np.float64)


class Judge:
    """Measures samples by Q itself, whatever scale the adversary learnt from."""

    def __init__(self, application: Application) -> None:
        self.application = application
        reference = load_reference(TRACK, application)
        if reference is None:
            raise ValueError(f"Expected a reference set of {TRACK}; run studies/reference_sets.py.")
        self._points, draws = reference.split()
        self.ideal = 1.0
        rows = [np.random.default_rng(i).choice(len(draws), SAMPLES, replace=False) for i in (0, 1)]
        figures = [self(draws[chosen], seed) for seed, chosen in enumerate(rows)]
        self.afr = float(np.mean([figure["afr"] for figure in figures]))
        self.ideal = float(np.mean([figure["coverage"] for figure in figures]))

    def __call__(self, mu: Mu, seed: int) -> dict[str, float]:
        test = Oracle(self.application, budget=len(mu), seed=seed, stream="test")
        scores = test(mu)
        rate = attack_fooling_rate(scores, test.threshold)
        covered = fooling_coverage(mu, fools(scores, test.threshold), self._points).coverage
        return {
            "afr": rate.rate,
            "low": rate.low,
            "high": rate.high,
            "coverage": covered / self.ideal,
        }


def train(name: str, scale: Scale, seed: int, judge: Judge) -> dict[str, Any]:
    """Train on one scale, and give the figures of the samples and what names them."""
    start = time.process_time()
    dimension = len(judge.application.parameters)
    adversary = adversaries.make(name, dimension, seed=seed)
    oracle = Oracle(judge.application, budget=BUDGET, seed=seed)
    adversary.train(ScaledOracle(oracle, scale))
    mu = adversary.sample(SAMPLES)
    seconds = time.process_time() - start
    sample = hashlib.sha256(mu.tobytes()).hexdigest()[:16]
    return {**judge(mu, seed), "seconds": seconds, "sample": sample}


def keeps(figures: list[dict[str, Any]]) -> bool:
    """Return whether one seed's figures on all scales keep the contract."""
    coverages = [figure["coverage"] for figure in figures]
    overlap = max(figure["low"] for figure in figures) <= min(figure["high"] for figure in figures)
    return overlap and max(coverages) - min(coverages) <= FARTHEST


def main() -> None:
    """Train what the record lacks, seed by seed, and print a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--adversaries", nargs="*", default=adversaries.names())
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--record", type=Path, required=True)
    chosen = parser.parse_args()
    application = make_application(TRACK)
    judge = Judge(application)
    uniform = np.random.default_rng(1).uniform(-1.0, 1.0, (UNIFORM, len(application.parameters)))
    scores = application.evaluate(uniform.astype(np.float32), range(UNIFORM)).score
    every = scales(scores)
    known: dict[tuple[str, str, int], dict[str, Any]] = {}
    if chosen.record.exists():
        for line in chosen.record.read_text().splitlines():
            row = json.loads(line)
            known[row["adversary"], row["scale"], row["seed"]] = row
    print(
        "| adversary |",
        *(f"{scale.name} |" for scale in every),
        "contract | s |",
    )
    print("| --- |", *("--- |" for _ in every), "--- | --- |")
    print(f"| ideal samples | {100 * judge.afr:.0f} / 1.00 |", *("= |" for _ in every[1:]), "| |")
    for name in chosen.adversaries:
        for seed in range(chosen.seeds):
            for scale in every:
                key = name, scale.name, seed
                if key not in known:
                    figures = train(name, scale, seed, judge)
                    row = {"adversary": name, "scale": scale.name, "seed": seed, **figures}
                    known[key] = row
                    chosen.record.parent.mkdir(parents=True, exist_ok=True)
                    with chosen.record.open("a") as file:
                        file.write(json.dumps(row) + "\n")
        print(table_row(name, every, chosen.seeds, known), flush=True)


def table_row(
    name: str, every: tuple[Scale, ...], seeds: int, known: dict[tuple[str, str, int], Any]
) -> str:
    """Write one adversary's row: means over seeds, and how many seeds keep the contract."""
    by_seed = [[known[name, scale.name, seed] for scale in every] for seed in range(seeds)]
    cells = []
    for of_scale in zip(*by_seed, strict=True):
        afr, coverage = (
            np.mean([figure[what] for figure in of_scale]) for what in ("afr", "coverage")
        )
        cells.append(f"{100 * afr:.0f} / {coverage:.2f}")
    if all(len({figure["sample"] for figure in figures}) == 1 for figures in by_seed):
        cells[1:] = ["=" for _ in cells[1:]]
    kept = sum(map(keeps, by_seed))
    seconds = np.mean([figure["seconds"] for figures in by_seed for figure in figures])
    return f"| `{name}` | {' | '.join(cells)} | {kept} of {seeds} | {seconds:.1f} |"


if __name__ == "__main__":
    main()
