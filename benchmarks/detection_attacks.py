"""BBGAN against random on detection: AFR by class and seed, and the lead with its interval.

    python benchmarks/detection_attacks.py --out runs/detection-attacks

Every attack has its own queries and its own test samples; `--out` keeps them, and a second call
goes on where the first was stopped.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from sada_gym.attack import AttackResult, attack
from sada_gym.metrics import attack_fooling_rate, lead_interval

CONTENDERS = {
    "random": ("random", None),
    "bbgan": ("bbgan", None),
    "bbgan-boost": ("bbgan-boost", None),
    "bbgan (paper)": ("bbgan", "paper"),
    "bbgan-boost (paper)": ("bbgan-boost", "paper"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--classes", nargs="*", default=["Car", "Chair", "Truck"])
    parser.add_argument("--contenders", nargs="*", default=list(CONTENDERS))
    parser.add_argument("--agent", default="photographer")
    parser.add_argument("--budget", type=int, default=2_000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/detection-attacks"))
    arguments = parser.parse_args()
    print(
        "| class | adversary | AFR by seed, % | AFR, % | lead over random, points | mu_std |\n"
        "| --- | --- | --- | --- | --- | --- |"
    )
    for name in arguments.classes:
        base = None
        for contender in arguments.contenders:
            adversary, preset = CONTENDERS[contender]
            runs = [
                _run(arguments, name, contender, adversary, preset, seed)
                for seed in range(arguments.seeds)
            ]
            scores = np.concatenate([run.samples.score for run in runs])
            rate = attack_fooling_rate(scores, runs[0].report.fooling_threshold)
            base = rate if contender == "random" else base
            lead = "" if base is None or base is rate else _points(*lead_interval(rate, base))
            print(
                f"| {name} | {contender} "
                f"| {', '.join(f'{100 * run.report.afr:.1f}' for run in runs)} "
                f"| {100 * rate.rate:.1f} ({_points(rate.low, rate.high)}) | {lead} "
                f"| {np.mean([run.report.mu_std for run in runs]):.3f} |",
                flush=True,
            )


def _run(
    arguments: argparse.Namespace,
    name: str,
    contender: str,
    adversary: str,
    preset: str | None,
    seed: int,
) -> AttackResult:
    return attack(
        f"SADA-Detection-{name}-v0",
        adversary,
        preset=preset,
        env_kwargs={"agent": arguments.agent},
        budget=0 if adversary == "random" else arguments.budget,
        seed=seed,
        workers=arguments.workers,
        out=arguments.out / f"{arguments.agent}-{name}-{contender}-{seed}",
        resume=True,
        pictures=False,
    )


def _points(low: float, high: float) -> str:
    return f"{100 * low:.1f} to {100 * high:.1f}"


if __name__ == "__main__":
    main()
