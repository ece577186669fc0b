"""SADA-Photos-Street: the rule that its ranges have to pass, and attacks beside ImageNet-C's grid.

    python -m studies.photos rates
    python -m studies.photos grid --out runs/photos-grid

`rates` says how often nominal and uniform worlds fool. `grid` shows the detector equally many
images in four ways: uniform worlds, ImageNet-C's grid (one condition at a time, at five
severities), `bbgan` and `level-set`, whose test samples count among the images. It says how many
worlds fool, how many of these differ, which share they cover of the failures among as many other
uniform worlds, and how many hold nothing but amounts that the grid calls harmless: up to these, at
most a tenth of its worlds fail. A second call goes on where the first stopped.
In brackets: 95 % intervals.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from sada_gym import attack, make_application
from sada_gym.application import Application
from sada_gym.foundations.arrays import Bools
from sada_gym.measures.search import anytime
from sada_gym.parameters import Mu
from studies.shares import share

TRACK = "SADA-Photos-Street-v0"
NOMINAL, UNIFORM = 200, 400
SEVERITIES = 5
SAMPLES = 100
HARMLESS = 0.1
"""The share of worlds that may fail where an amount is called harmless."""


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


def harmless(one: Mu, fooled: Bools, usual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends, (d,) each, up to which one condition at a time does no harm.

    `one` are the rows of the grid, (n, d), and `fooled`, (repeats, n), says which of them failed.
    """
    low, high = usual.copy(), usual.copy()
    stopped = set()
    for row, failed in zip(one, fooled.mean(axis=0), strict=True):  # milder ones come first
        axis = int(np.abs(row - usual).argmax())
        side = low if row[axis] < usual[axis] else high
        if failed > HARMLESS:
            stopped.add((axis, side is low))
        elif (axis, side is low) not in stopped:
            side[axis] = row[axis]
    return low, high


def grid(application: Application, worlds: int, out: Path) -> None:
    """Compare four ways to spend as many worlds."""
    rng, threshold = np.random.default_rng(0), application.fooling_threshold

    def learnt(name: str) -> tuple[Mu, np.ndarray]:
        run = attack(
            *(TRACK, name),
            budget=worlds - SAMPLES,
            samples=SAMPLES,
            out=out / name,
            resume=True,
            diagnose=False,
            pictures=False,
        )
        parts = run.queries, run.samples
        return np.concatenate([p.mu for p in parts]), np.concatenate([p.score for p in parts])

    def scored(name: str, mu: Mu) -> tuple[Mu, np.ndarray]:
        file = out / f"{name}.npz"
        seeds = rng.integers(0, 2**31, len(mu)).tolist()
        if not file.exists():
            np.savez(file, mu=mu, score=application.evaluate(mu, seeds).score)
        with np.load(file) as kept:
            return kept["mu"], kept["score"]

    def uniform(name: str) -> tuple[Mu, np.ndarray]:
        mu = rng.uniform(-1.0, 1.0, (worlds, len(application.parameters)))
        return scored(name, mu.astype(np.float32))

    rows = {name: learnt(name) for name in ("level-set", "bbgan")}
    one = severities(application)
    repeats = worlds // len(one)
    rows["uniform worlds"] = uniform("uniform")
    rows["one condition at a time"] = scored("grid", np.tile(one, (repeats, 1)))
    mu, score = uniform("others")
    others = mu[score <= threshold]
    fooled = rows["one condition at a time"][1] <= threshold
    low, high = harmless(one, fooled.reshape(repeats, -1), np.asarray(application.nominal))
    ends = application.parameters.physical(np.stack([low, high])).T.tolist()
    for name, (least, most) in zip(application.parameters.names, ends, strict=True):
        print(f"harmless alone: {name} {least:.4g} to {most:.4g}")
    print("| way | worlds that fool | different ones | cover | of harmless amounts alone |")
    print("| --- " * 5 + "|")
    for name, (mu, score) in rows.items():
        fails = score <= threshold
        inside = ((mu >= low) & (mu <= high)).all(axis=1) & fails
        (point,) = anytime(mu, score, threshold, others, [len(mu)])
        print(
            f"| {name} | {share(fails)}, {fails.sum()} of {len(mu)} | {point.found} | "
            f"{100 * point.coverage:.0f} % of {len(others)} | {inside.sum()} |"
        )


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("rates", "grid"))
    parser.add_argument("--images", type=int, default=1_000, help="that each way shows")
    parser.add_argument("--out", type=Path, default=Path("runs/photos-grid"))
    given = parser.parse_args()
    application = make_application(TRACK)
    if given.what == "rates":
        rates(application)
    else:
        grid(application, given.images // application.batch, given.out)


if __name__ == "__main__":
    main()
