"""SADA-Photos-Street: the rule that its ranges have to pass, and attacks beside ImageNet-C's grid.

    python -m studies.photos rates
    python -m studies.photos grid --images 2000 --out runs/photos-grid

`rates` says how often nominal and uniform worlds fool. `grid` shows the detector equally many
images in four ways: uniform worlds, ImageNet-C's grid (one condition at a time, at five
severities), `bbgan` and `level-set`, whose test samples count among the images. It says how many
worlds failed, how many groups they form, and how many hold nothing but amounts that are harmless
alone. In brackets: 95 % intervals.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from sada_gym import attack, make_application
from sada_gym.application import Application
from sada_gym.foundations.arrays import Bools
from sada_gym.measures.groups import distinct
from sada_gym.parameters import Mu
from studies.shares import share

TRACK = "SADA-Photos-Street-v0"
NOMINAL, UNIFORM = 200, 400
SEVERITIES = 5
SAMPLES = 100


def rates(application: Application) -> None:
    """Say how often nominal and uniform worlds fool."""
    rng = np.random.default_rng(1)
    usual = np.repeat(np.asarray(application.nominal)[None], NOMINAL, axis=0)
    uniform = rng.uniform(-1.0, 1.0, (UNIFORM, usual.shape[1])).astype(np.float32)
    for name, mu in (("nominal", usual), ("uniform", uniform)):
        seeds = rng.integers(0, 2**31, len(mu)).tolist()
        print(name, share(application.evaluate(mu, seeds).fooled))


def severities(application: Application) -> Mu:
    """One condition at a time, at five severities to each of its ends."""
    usual, rows = np.asarray(application.nominal), []
    for axis in range(len(usual)):
        for end in (-1.0, 1.0):
            for step in range(1, SEVERITIES + 1) if usual[axis] != end else ():
                rows.append(usual.copy())
                rows[-1][axis] += step / SEVERITIES * (end - usual[axis])
    return np.array(rows, np.float32)


def grid(application: Application, worlds: int, out: Path) -> None:
    """Compare four ways to spend as many worlds."""
    rng, d = np.random.default_rng(0), len(application.parameters)
    harmless: tuple[np.ndarray, np.ndarray] | None = None
    rows: dict[str, tuple[Mu, Bools]] = {}
    for name in ("level-set", "bbgan"):
        run = attack(
            *(TRACK, name),
            budget=worlds - SAMPLES,
            samples=SAMPLES,
            seed=0,
            out=out / name,
            resume=True,
        )
        known = [
            (part.mu, part.fooled(application.fooling_threshold))
            for part in (run.queries, run.samples)
        ]
        rows[name] = tuple(np.concatenate(part) for part in zip(*known, strict=True))
        combined = run.result.nominal.combined
        if harmless is None:
            ends = np.array([*combined.harmless.values()]).T
            harmless = tuple(application.parameters.normalised(end) for end in ends)
    one = severities(application)
    repeated = one[np.arange(worlds) % len(one)]
    uniform = rng.uniform(-1.0, 1.0, (worlds, d)).astype(np.float32)
    for name, mu in (("uniform worlds", uniform), ("one condition at a time", repeated)):
        seeds = rng.integers(0, 2**31, worlds).tolist()
        rows[name] = mu, application.evaluate(mu, seeds).fooled
    low, high = harmless
    print("way | worlds that fool | groups | of nothing but harmless amounts")
    for name, (mu, fooled) in rows.items():
        inside = ((mu >= low) & (mu <= high)).all(axis=1) & fooled
        groups = len(distinct(mu[fooled], application.parameters)) if fooled.any() else 0
        print(f"{name} | {int(fooled.sum())} of {len(mu)} | {groups} | {int(inside.sum())}")


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("rates", "grid"))
    parser.add_argument("--images", type=int, default=2_000, help="that each way shows")
    parser.add_argument("--out", type=Path, default=Path("runs/photos-grid"))
    given = parser.parse_args()
    application = make_application(TRACK)
    if given.what == "rates":
        rates(application)
    else:
        grid(application, given.images // application.batch, given.out)


if __name__ == "__main__":
    main()
