"""What fails a racing pilot.

    python -m studies.racing_diagnosis

First how sharply tracks turn. Then its fooling rate and mean Q by the geometry of the tracks:
fifths of the shipped reference sets' uniform mu, from the mildest to the hardest, for each of three
measures of a track, and the rank correlation (Spearman) with Q; and of the mu that are drawn back
so that the track can be built. Then what becomes of a lap after a gate is missed, on other uniform
mu, which are flown for it.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import spearmanr

from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.episodes import RaceDistribution
from sada_gym.envs.uav.world.track import TEMPLATES
from sada_gym.measures.reference import Reference, load_reference

FIFTHS = 5


def measures(reference: Reference, anchors: int) -> dict[str, tuple[npt.NDArray[np.float64], int]]:
    """Each measure of all points, (n,), and the sign with which a track gets harder."""
    tracks = TEMPLATES[anchors].tracks(reference.mu)
    return {
        "sharpest turn, °": (tracks.sharpest_turn_deg(), 1),
        "closest frames, m": (tracks.closest_m(), -1),
        "length, m": (tracks.length_m, -1),
    }


def print_turns(samples: int) -> None:
    """How sharply undisturbed tracks, mild ones and those of uniform mu turn."""
    print("| anchors | mu within | sharpest turn, 5 % | 50 % | 95 % |")
    print("| --- | --- | --- | --- | --- |")
    for anchors, template in TEMPLATES.items():
        unit = np.random.default_rng(0).uniform(-1, 1, (samples, len(template.parameters)))
        for reach in (0.0, RaceDistribution().spread, 1.0):
            sharpest = template.tracks(reach * unit).sharpest_turn_deg()
            low, middle, high = np.quantile(sharpest, [0.05, 0.5, 0.95])
            print(f"| {anchors} | ±{reach} | {low:.0f} | {middle:.0f} | {high:.0f} |")


def lengths(endings: Sequence[str]) -> list[int]:
    """How many gates were missed one after another, each time that any was."""
    grouped = itertools.groupby(ending != "passed" for ending in endings)
    return [len(list(run)) for missed, run in grouped if missed]


def print_misses(agent: str, samples: int) -> None:
    """Fly uniform mu, and tell what a miss costs and how it came."""
    kinds = "misses of one gate | of more | most | hit | late | lost"
    print(f"\n| anchors | laps without a miss | {kinds} |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for anchors in TEMPLATES:
        application = UAVApplication(anchors, agent=agent)
        rng = np.random.default_rng(0)
        mu = rng.uniform(-1, 1, (samples, len(application.parameters)))
        outcomes = application.evaluate(mu, rng.integers(2**31, size=samples).tolist())
        runs = [run for info in outcomes.infos for run in lengths(info["endings"])]
        endings = [ending for info in outcomes.infos for ending in info["endings"]]
        alone = runs.count(1)
        print(
            f"| {anchors} | {100 * (outcomes.score == 1).mean():.0f} % | {alone} "
            f"| {len(runs) - alone} | {max(runs, default=0)} | {endings.count('hit')} "
            f"| {endings.count('late')} | {endings.count('lost')} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agent", default="ppo")
    parser.add_argument("--samples", type=int, default=500, help="flown to see what a miss costs")
    arguments = parser.parse_args()
    print_turns(1_000)
    print("\n| anchors | measure | fifth | from | to | fooled | mean Q | rank correlation with Q |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for anchors in TEMPLATES:
        application = UAVApplication(anchors, agent=arguments.agent)
        reference = load_reference(f"SADA-UAV-{anchors}Anchors-v0", application)
        if reference is None:
            raise SystemExit(f"There is no reference set of {arguments.agent}, {anchors} anchors.")
        rate = reference.fooling_rate
        for name, (values, sign) in measures(reference, anchors).items():
            correlation = spearmanr(values, reference.mean_score).statistic
            for number, rows in enumerate(np.array_split(np.argsort(sign * values), FIFTHS)):
                ends = np.sort(values[rows])[[0, -1]]
                print(
                    f"| {anchors} | {name} | {number + 1} | {ends[0]:.1f} | {ends[1]:.1f} "
                    f"| {100 * rate[rows].mean():.1f} % | {reference.mean_score[rows].mean():.3f} "
                    f"| {correlation:+.2f} |"
                )
        back = TEMPLATES[anchors].tracks(reference.mu).kept < 1
        print(
            f"| {anchors} | drawn back | {100 * back.mean():.1f} % of mu | | "
            f"| {100 * rate[back].mean():.1f} % | {reference.mean_score[back].mean():.3f} | |"
        )
    print_misses(arguments.agent, arguments.samples)


if __name__ == "__main__":
    main()
