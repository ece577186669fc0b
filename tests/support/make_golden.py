"""Makes the golden folder anew, a small board with what the verifier finds on it.

    python tests/support/make_golden.py

Its track is analytic, so that scores are the same on every machine. Look at the difference before
you commit it: the verifier should change its mind only where it was changed.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
from made_entries import change_samples, make_entry, uniform

from sada_gym.board.submission.verification import verify
from sada_gym.evaluations import Evaluations

GOLDEN = Path(__file__).parents[1] / "leaderboard" / "golden"
NONCE = "golden"


def at_the_centre(seed: int, count: int, dimension: int) -> npt.NDArray[np.float64]:
    """Draw samples that crowd where no fooling box is."""
    return uniform(seed + 10, count, dimension) * 0.01


def near_two_points(seed: int, count: int, dimension: int) -> npt.NDArray[np.float64]:
    """Draw samples that are one of two points."""
    return np.where(uniform(seed + 20, count, 1) < 0.0, -0.5, 0.5) * np.ones(dimension)


def claim_one_score(samples: Evaluations) -> Evaluations:
    """Claim one score of all samples."""
    return dataclasses.replace(samples, score=np.full(len(samples), 0.125))


def main() -> None:
    """Make the entries, and verify them."""
    shutil.rmtree(GOLDEN, ignore_errors=True)
    make_entry(GOLDEN, "honest", seeds=1)
    make_entry(GOLDEN, "thief", seeds=1, rule="equal-queries")  # the same samples
    make_entry(GOLDEN, "two-points", seeds=1, draw=near_two_points)
    make_entry(GOLDEN, "at-the-centre", seeds=1, draw=at_the_centre)
    make_entry(GOLDEN, "edited", seeds=1, draw=lambda seed, *size: uniform(seed + 30, *size))
    change_samples(GOLDEN / "edited", claim_one_score)
    for finding in verify(sorted(GOLDEN.iterdir()), NONCE):
        assert finding.verified is not None, finding
        print(finding.entry, finding.place, finding.verified.flags)


if __name__ == "__main__":
    main()
