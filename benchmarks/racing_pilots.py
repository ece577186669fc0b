"""At which speed `waypoint-pid` flies: the table by which it was chosen.

`python benchmarks/racing_pilots.py` trains three pilots at each speed and flies them on tracks as
they were trained for. The rule: the highest of the speeds, in steps of 0.5 m/s, at which all three
pass at least 98 % of the gates of every undisturbed template and 95 % of those of mild tracks, and
which is no higher than `racing_speeds.py` allows. No uniform mu is flown.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from sada_gym.agents.pilot.evaluate import fly_nominal, share
from sada_gym.agents.pilot.recipe import MILD, RECIPES, Imitation
from sada_gym.agents.pilot.train import train
from sada_gym.agents.pilot.weights import save
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.pilot import WaypointPilot
from sada_gym.envs.uav.templates import TEMPLATES


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=float, nargs="*", default=[12.0, 11.5, 11.0, 10.5])
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2])
    parser.add_argument("--out", type=Path, help="a folder for the weights")
    arguments = parser.parse_args()
    recipe = RECIPES["waypoint-pid"]
    assert isinstance(recipe, Imitation)
    print(
        "| m/s | training seed | anchors | gates passed, template | gates passed, mild tracks "
        "| holds |\n| --- | --- | --- | --- | --- | --- |",
        flush=True,
    )
    for speed in arguments.speeds:
        course = replace(MILD, speed_m_s=speed)
        for seed in arguments.seeds:
            network = train(replace(recipe, course=course), seed=seed)
            if arguments.out is not None:
                folder = arguments.out / f"{speed:g}-{seed}"
                folder.mkdir(parents=True, exist_ok=True)
                save(network, folder / "waypoint-pid.safetensors")
            for anchors in TEMPLATES:
                application = UAVApplication(anchors, agent=WaypointPilot(network, speed))
                flown = fly_nominal(application, np.random.default_rng(seed + 1_000))
                print(
                    f"| {speed:g} | {seed} | {anchors} "
                    f"| {share(flown.template_passed, flown.template_gates)} "
                    f"| {share(flown.mild_passed, flown.mild_gates)} "
                    f"| {'yes' if flown.holds else 'no'} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
