"""UAV racing's speed, as ratios within one run: `make bench`. No test fails on a time.

The yardsticks are real time, and bare PyBullet stepping of the same bodies.
"""

import statistics
import time

import numpy as np
import pytest

from sada_gym.envs.uav.agent.network import WaypointNetwork
from sada_gym.envs.uav.agent.pilot import PrivilegedPilot, WaypointPilot
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.world.drone import SIMULATION_HZ, upright
from sada_gym.envs.uav.world.physics import FreeBodies

RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (UAVApplication.worlds_at_once, 8)).astype(np.float32)
SEEDS = RNG.integers(2**31, size=UAVApplication.worlds_at_once).tolist()
STEPS = 1_000
SPEEDS: dict[str, float] = {}
"""Simulated seconds of one drone in a second, by what was measured."""


class Looking(WaypointPilot):
    """Sees with an untrained network, but flies as it is told: the full cost of usual flights."""

    def act(self, races, which):
        super().act(races, which)
        return PrivilegedPilot().act(races, which)


def record(benchmark, name, simulated_s):
    SPEEDS[name] = simulated_s / statistics.median(benchmark.stats.stats.data)
    benchmark.extra_info["times real time"] = SPEEDS[name]


def flown(application, count):
    return sum(info["time_s"] for info in application.evaluate(MU[:count], SEEDS[:count]).infos)


@pytest.mark.parametrize(
    ("name", "agent", "count"),
    [
        ("a batch, ppo", "ppo", UAVApplication.worlds_at_once),
        ("one race, ppo", "ppo", 1),
        ("a batch, told the truth", PrivilegedPilot(), UAVApplication.worlds_at_once),
        ("a batch, seeing", Looking(WaypointNetwork()), UAVApplication.worlds_at_once),
        ("one race, seeing", Looking(WaypointNetwork()), 1),
    ],
)
def test_evaluations(benchmark, name, agent, count):
    application = UAVApplication(4, agent=agent)
    simulated_s = flown(application, count)
    benchmark.pedantic(flown, args=(application, count), rounds=3)
    record(benchmark, name, simulated_s)


def test_bare_stepping(benchmark):
    bodies, velocities = FreeBodies(), RNG.normal(0, 5, (UAVApplication.worlds_at_once, 6))
    bodies.place(np.tile(upright((0, 0, 200), 0)[:7], (UAVApplication.worlds_at_once, 1)))

    def step():
        for _ in range(STEPS):
            bodies.step(velocities)

    benchmark.pedantic(step, rounds=5)
    record(benchmark, "bare stepping", UAVApplication.worlds_at_once * STEPS / SIMULATION_HZ)


def test_the_ratios(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: simulated seconds of one drone in a second")
        for name, speed in SPEEDS.items():
            share = speed / SPEEDS["bare stepping"]
            print(f"{name:>25}: {speed:8.0f} ({100 * share:.1f} % of bare stepping)")
