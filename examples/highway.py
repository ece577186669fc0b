"""Attack a driver on highway-env's own highway-fast-v0: on which roads, how full, does it crash?

    python examples/highway.py

The driver is a plain function that keeps its distance and overtakes. It was written for three
lanes. A trained agent goes in the same place, but highway-env takes some 0.05 s a step, so that
training one takes longer than this whole example, which takes three minutes.
"""

import highway_env  # noqa: F401 - registers highway-fast-v0
import numpy as np

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import Config, ObservationDropout

LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
LANES, LANE_M = 3, 4.0
SCALES = np.array([200.0, LANES * LANE_M, 80.0])  # of x in m, y in m and vx in m/s
LOOKAHEAD_S = 2.0


def drive(observation: np.ndarray) -> int:
    """Choose an action for what the car sees.

    Args:
        observation: (5, 5): presence, x, y, vx and vy of the own car, then, relative to it, of the
            four nearest cars ahead.
    """
    x, y, speed = (observation[1:, 1:4] * SCALES).T
    seen = observation[1:, 0] > 0.5
    lane = round(observation[0, 2] * SCALES[1] / LANE_M)

    def gap(side: int, behind_m: float) -> float:
        there = seen & (abs(y - side * LANE_M) < 0.6 * LANE_M) & (x > -behind_m)
        return float(min((x + LOOKAHEAD_S * speed)[there], default=SCALES[0]))

    ahead = gap(0, 0.0)
    if ahead > 20.0:
        return FASTER if ahead > 30.0 else IDLE
    sides = {side: gap(side, 10.0) for side in (-1, 1) if 0 <= lane + side < LANES}
    best = max(sides, key=lambda side: sides[side], default=0)
    if sides.get(best, 0.0) > max(ahead, 10.0):
        return LEFT if best < 0 else RIGHT
    return SLOWER


application = GymnasiumApplication(
    "highway-fast-v0",
    agent=drive,
    parameters={
        "density": Config(0.5, 2.0, name="vehicles_density"),  # 1 is the usual traffic
        "lanes": Config(2, 5, integer=True, name="lanes_count"),
        "dropout": ObservationDropout(
            0.0, 0.8
        ),  # the share of seconds in which it sees nothing new
    },
    score=("length", 30),  # seconds without a crash
    fooling_threshold=0.9,
    max_steps=30,
    agent_id="keeps its distance, 1",  # change it with the function
)


if __name__ == "__main__":
    run = attack(
        application, "random", budget=0, samples=100, seed=0, out="runs/highway", resume=True
    )
    print(f"{run.result.afr:.0%} of the worlds fool the driver")
    print(f"pictures of them: {run.folder}/fooled.png")
