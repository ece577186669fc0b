"""What fails a racing pilot: its fooling rate and mean Q by the geometry of the tracks.

    python benchmarks/racing_diagnosis.py

It reads the shipped reference sets and evaluates nothing: fifths of uniform mu, from the mildest to
the hardest, for each of three measures of a track, and the rank correlation (Spearman) with Q.
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt
from scipy.stats import spearmanr

from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.templates import TEMPLATES
from sada_gym.envs.uav.track import Tracks
from sada_gym.reference import Reference, load_reference

FIFTHS = 5


def measures(reference: Reference, anchors: int) -> dict[str, tuple[npt.NDArray[np.float64], int]]:
    """Each measure of all points, (n,), and the sign with which a track gets harder."""
    tracks = Tracks(TEMPLATES[anchors].displaced(reference.mu))
    return {
        "sharpest turn, °": (np.abs(tracks.turns_deg()).max(axis=1), 1),
        "closest frames, m": (tracks.closest_m(), -1),
        "length, m": (tracks.length_m, -1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agent", default="waypoint-pid")
    arguments = parser.parse_args()
    print("| anchors | measure | fifth | from | to | fooled | mean Q | rank correlation with Q |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for anchors in TEMPLATES:
        application = UAVApplication(anchors, agent=arguments.agent)
        reference = load_reference(f"SADA-UAV-{anchors}Anchors-v0", application)
        if reference is None:
            raise SystemExit(f"There is no reference set of {arguments.agent}, {anchors} anchors.")
        rate = reference.fooled / reference.entry.seeds
        for name, (values, sign) in measures(reference, anchors).items():
            correlation = spearmanr(values, reference.mean_score).statistic
            for number, rows in enumerate(np.array_split(np.argsort(sign * values), FIFTHS)):
                ends = np.sort(values[rows])[[0, -1]]
                print(
                    f"| {anchors} | {name} | {number + 1} | {ends[0]:.1f} | {ends[1]:.1f} "
                    f"| {100 * rate[rows].mean():.1f} % | {reference.mean_score[rows].mean():.3f} "
                    f"| {correlation:+.2f} |"
                )


if __name__ == "__main__":
    main()
