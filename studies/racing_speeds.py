"""How fast pilots fly that know the gates' places: by this the privileged pilot's speed was chosen.

`python -m studies.racing_speeds` prints the table. The rule: the highest speed, in steps of 1 m/s
from 4 m/s up, at which the pilot is not fooled by at least 99.5 % of uniform mu with each number of
anchors. No pilot that learnt is asked.
"""

import argparse

import numpy as np

from sada_gym.envs.uav.agent.pilot import PrivilegedPilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.world.track import TEMPLATES
from studies.training.measuring import evaluate_uniform

MILD, FEASIBLE_SHARE = 0.25, 0.995


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=float, nargs="+", default=[4, 5, 6, 7, 8, 9, 11.5])
    parser.add_argument("--templates", type=int, default=32)
    parser.add_argument("--mild", type=int, default=100)
    parser.add_argument("--uniform", type=int, default=500)
    arguments = parser.parse_args()
    print(
        "| m/s | anchors | gates passed, template | mild | uniform | uniform mu with Q > 0.7 "
        "| mean time |\n| --- | --- | --- | --- | --- | --- | --- |"
    )
    for speed in arguments.speeds:
        for anchors in TEMPLATES:
            application = UAVApplication(anchors, agent=PrivilegedPilot(speed))
            rng = np.random.default_rng(0)
            flights = [
                evaluate_uniform(application, count, rng, spread=spread)[2]
                for count, spread in (
                    (arguments.templates, 0.0),
                    (arguments.mild, MILD),
                    (arguments.uniform, 1.0),
                )
            ]
            passed = " | ".join(f"{100 * flown.score.mean():.1f} %" for flown in flights)
            uniform = flights[-1]
            time_s = np.mean([info["time_s"] for info in uniform.infos])
            print(
                f"| {speed:g} | {anchors} | {passed} | {100 * (~uniform.fooled).mean():.1f} % "
                f"| {time_s:.1f} s |",
                flush=True,
            )


if __name__ == "__main__":
    main()
