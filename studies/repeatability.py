"""How far the seed, and not the world's parameters, decides whether an agent is fooled.

    python -m studies.repeatability

For each shipped reference set: how many evaluations fool, how many points are in the fooling set,
and how often a point that fooled on one seed fools on another too. Where that is seldom, what an
adversary learns from a single evaluation of a point is mostly luck.
"""

from __future__ import annotations

import numpy as np

from sada_gym import agents
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.registration import tracks
from sada_gym.measures.reference import load_reference


def main() -> None:
    print("| track | agent | points | seeds | evaluations that fool | fooling set | fools again |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for track in tracks(installed=True):
        for agent in agents.names(make_application(track).name):
            reference = load_reference(track, make_application(track, agent=agent))
            if reference is None:
                continue
            fooled, seeds = reference.fooled.astype(np.int64), reference.entry.seeds
            share = reference.fooling_rate.mean()
            again = (fooled * (fooled - 1)).sum() / (fooled.sum() * (seeds - 1))
            print(
                f"| {track} | {agent} | {len(fooled)} | {seeds} | {100 * share:.1f} % "
                f"| {100 * reference.fooling.mean():.1f} % | {100 * again:.1f} % |"
            )


if __name__ == "__main__":
    main()
