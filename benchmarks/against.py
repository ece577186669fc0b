"""Evaluations a second of this commit against another one's, in one run.

    python -m benchmarks.against 81cc8a5 SADA-Detection-Car-v0 photographer
    python -m benchmarks.against 81cc8a5 SADA-UAV-4Anchors-v0 ppo

Either commit evaluates a batch of 64 uniform mu with one thread and its own agent of that name, in
a process of its own; the two take turns. Processor time counts, so that other programs matter less.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 5
ROOT = Path(__file__).resolve().parents[1]
CODE = """
import sys, time
import numpy as np, torch
from sada_gym import make_application

torch.set_num_threads(1)
application = make_application(sys.argv[1], agent=sys.argv[2])
rng = np.random.default_rng(0)
mu = rng.uniform(-1, 1, (64, len(application.parameters))).astype(np.float32)
seeds = rng.integers(2**31, size=64).tolist()
application.evaluate(mu, seeds)
for _ in range(3):
    started = time.process_time()
    application.evaluate(mu, seeds)
    print((time.process_time() - started) / 64)
"""


def measure(tree: Path, cache: Path, track: str, agent: str) -> list[float]:
    """Return three times of an evaluation, in s of one core, with the package in a folder."""
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "NUMBA_CACHE_DIR": str(cache),
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, "-c", CODE, track, agent]
    run = subprocess.run(
        command, env=environment, cwd=tree, check=True, stdout=subprocess.PIPE, text=True
    )
    return [float(line) for line in run.stdout.split()]


def main() -> None:
    """Print the two medians and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("track")
    parser.add_argument("agent")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        other = Path(folder) / "other"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", other, options.commit], check=True)
        try:
            times: dict[Path, list[float]] = {other: [], ROOT: []}
            for _ in range(ROUNDS):
                for tree, found in times.items():
                    cache = Path(folder) / ("cache" if tree == ROOT else "other-cache")
                    found += measure(tree, cache, options.track, options.agent)
        finally:
            subprocess.run([*git, "remove", "--force", other], check=True)
    before, now = (1e3 * statistics.median(found) for found in times.values())
    print(
        f"{options.track}, {options.agent}: {before:.2f} ms at {options.commit}, {now:.2f} ms now"
    )
    print(f"{before / now:.2f} times as many evaluations a second")


if __name__ == "__main__":
    main()
