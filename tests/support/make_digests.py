"""Makes the digests of small attacks, one a track; `tests/foundations/test_arithmetic.py` has them.

    python tests/support/make_digests.py [TRACK ...]

They change where scores, samples or the way of learning change. Look at the difference before you
commit it.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from pathlib import Path

import sada_gym  # isort: skip - first, as it chooses the kernels

import numpy as np
from families import MISSING

from sada_gym import attack

FILE = Path(__file__).parents[1] / "digests" / "attacks.json"
SLOW = {"budget": 6, "samples": 4}
USUAL = {"budget": 40, "samples": 10}
ADVERSARIES = ("level-set", "gp", "bayesian", "svm", "smc", "gmm50")
BY_TRACK = {
    "SADA-Detection-Car-v0": "bbgan",
    "SADA-UAV-3Anchors-v0": "level-set",
    "SADA-Robot-Warehouse-v0": "gp",
    "SADA-Quadrotor-Crazyflie-v0": "gmm50",
    "SADA-Quadrotor-X500-v0": "level-set",
    "SADA-Flight-C172-v0": "gp",
    "SADA-Flight-C310-v0": "gmm50",
    "SADA-Flight-Global5000-v0": "svm",
    "SADA-Photos-Street-v0": "gmm50",
}


def digest(track: str) -> str:
    """Attack a track, and digest the queries, the samples and their scores."""
    number = sada_gym.tracks().index(track)
    slow = "Driving" in track or "Go2" in track
    name = "random" if slow else BY_TRACK.get(track, ADVERSARIES[number % len(ADVERSARIES)])
    run = attack(
        track,
        name,
        seed=0,
        pictures=False,
        diagnose=False,
        progress=False,
        **(SLOW if slow else USUAL),
    )
    content = hashlib.sha256()
    for part in (run.queries, run.samples):
        content.update(part.mu.tobytes() + part.score.tobytes())
    return f"{name} {content.hexdigest()[:16]}"


def libm() -> str:
    """Digest what the mathematics library of this machine answers: its versions round otherwise."""
    values = np.random.default_rng(0).normal(size=2_000)
    functions = (math.sin, math.cos, math.exp, math.tanh, math.atan, math.expm1)
    answers = [[function(value) for value in values.tolist()] for function in functions]
    answers += [[math.log(value), value**1.7] for value in abs(values).tolist()]
    return hashlib.sha256(repr(answers).encode()).hexdigest()[:16]


def main() -> None:
    """Write the file."""
    known = json.loads(FILE.read_text()) if FILE.exists() else {"attacks": {}}
    for track in sys.argv[1:] or [name for name in sada_gym.tracks() if not MISSING[name]]:
        known["attacks"][track] = digest(track)
        print(track, known["attacks"][track], flush=True)
        FILE.write_text(json.dumps({**known, "libm": libm()}, indent=1) + "\n")


if __name__ == "__main__":
    main()
