"""The first minute with any environment: `sada-gym init`, then `attack` with nothing edited.

    python -m studies.first_minute --out runs/first-minute

Each environment's stand-in agent learns for a few thousand steps only, so the rates say nothing
about what these environments are like: the table shows that the way works. An environment that is
in the folder already is read, not done again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ENVIRONMENTS = (
    "CartPole-v1",
    "Acrobot-v1",
    "Pendulum-v1",
    "MountainCarContinuous-v0",
    "LunarLander-v3",
    "BipedalWalker-v3",
    "InvertedPendulum-v5",
    "Hopper-v5",
    "FrozenLake-v1",
    "highway_env:highway-fast-v0",
)


def run(env_id: str, folder: Path, steps: int, budget: int, samples: int) -> dict[str, Any] | None:
    """Write the first file of an environment, attack it, and say what came out.

    It returns None where the stand-in is no better than random actions: its file has no threshold.
    """
    name = env_id.rpartition(":")[2]
    file, out = folder / f"{name}.toml", folder / name
    started = time.monotonic()
    if not file.exists():
        _sada_gym("init", env_id, "--steps", steps, "--out", file)
    made = time.monotonic()
    if "\nfooling_threshold" not in file.read_text(encoding="utf-8"):
        return None
    _sada_gym(
        *("attack", file, "--budget", budget, "--samples", samples, "--workers", 1, "--resume"),
        *("--out", out),
    )
    report = json.loads((out / "result.json").read_text())
    uniform, nominal = report["uniform"], report["nominal"]
    settings = report["settings"]["experiment"]["target"]["application"]["settings"]
    return {
        "environment": name,
        "parameters": settings["order"],
        "nominal": nominal and nominal["score"],
        "uniform": uniform and uniform["fooled"] / uniform["worlds"],
        "afr": report["afr"],
        "smallest": nominal and [change["parameter"] for change in nominal["smallest"]],
        "init_s": made - started,
        "attack_s": time.monotonic() - made,
    }


def _sada_gym(*words: object) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sada_gym", *map(str, words)], capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"sada-gym {' '.join(map(str, words))}:\n{done.stderr}")


def row(found: dict[str, Any]) -> str:
    """Write a row of the table."""

    def percent(share: float | None) -> str:
        return "-" if share is None else f"{100 * share:.0f}"

    nominal = "-" if found["nominal"] is None else f"{found['nominal']:.2f}"
    cells = (
        *(f"`{found['environment']}`", ", ".join(found["parameters"]), nominal),
        *(percent(found["uniform"]), percent(found["afr"])),
        ", ".join(dict.fromkeys(found["smallest"] or ())) or "-",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Run all environments and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/first-minute"))
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--samples", type=int, default=50)
    parser.add_argument("--environments", nargs="*", default=ENVIRONMENTS)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print(
        "| environment | parameters | nominal score | uniform, % | `level-set`, % | fails alone |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for env_id in options.environments:
        found = run(env_id, options.out, options.steps, options.budget, options.samples)
        if found is None:
            print(f"{env_id}: no better than random actions", file=sys.stderr, flush=True)
            continue
        print(row(found), flush=True)
        print(f"{found['init_s']:.0f} s + {found['attack_s']:.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
