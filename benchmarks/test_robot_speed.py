"""The robot's speed: `make bench`. No test fails on a time.

The yardstick is bare pymunk stepping of the same bodies.
"""

import statistics
import time

import numpy as np
import pytest

from sada_gym.envs.robot.application import RobotApplication
from sada_gym.envs.robot.episodes import STEP_S, SUBSTEPS, RobotEpisodes
from sada_gym.envs.robot.start import PLANS, TripDistribution
from sada_gym.envs.robot.task import RobotTaskVectorEnv
from sada_gym.envs.robot.world.floor_plan import floor_plan
from sada_gym.foundations.determinism import one_thread

RNG = np.random.default_rng(0)
WORLDS = 32
MU = RNG.uniform(-1, 1, (WORLDS, 10)).astype(np.float32)
SEEDS = RNG.integers(2**31, size=WORLDS).tolist()
STEPS = 200
FOUND: dict[str, str] = {}


@pytest.mark.parametrize("count", [WORLDS, 1])
def test_evaluations(benchmark, count):
    application = RobotApplication()
    application.evaluate(MU[:count], SEEDS[:count])
    with one_thread():
        benchmark.pedantic(application.evaluate, args=(MU[:count], SEEDS[:count]), rounds=3)
    a_minute = 60 * count / statistics.median(benchmark.stats.stats.data)
    FOUND[f"evaluations a minute, {count} at a time"] = f"{a_minute:.0f}"


def test_decisions(benchmark):
    for number in range(PLANS):  # once a training; they are kept
        floor_plan(number)
    tasks = RobotTaskVectorEnv(TripDistribution(), num_envs=64)
    tasks.reset(seed=0)

    def drive():
        for _ in range(STEPS):
            tasks.step(np.tile(np.float32([0.5, 0.1]), (64, 1)))

    benchmark.pedantic(drive, rounds=3, warmup_rounds=1)
    microseconds = 1e6 * statistics.median(benchmark.stats.stats.data) / (64 * STEPS)
    FOUND["µs a decision without a network"] = f"{microseconds:.0f}"


def test_bare_stepping(benchmark):
    (bodies,) = RobotEpisodes([TripDistribution().draw(RNG)])._bodies

    def step():
        for _ in range(STEPS * SUBSTEPS):
            bodies._space.step(STEP_S)

    benchmark.pedantic(step, rounds=5)
    microseconds = 1e6 * statistics.median(benchmark.stats.stats.data) / STEPS
    FOUND["µs of bare pymunk a decision"] = f"{microseconds:.0f}"


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: the robot")
        for name, figure in FOUND.items():
            print(f"{name:>45}: {figure}")
