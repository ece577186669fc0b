"""MetaDrive's speed: `make bench`. No test fails on a time.

The yardstick is MetaDrive's own loop in the same world: its environment, and its expert as its
examples call it.
"""

import statistics
import time

import numpy as np
import pytest
from zoo import needs

from sada_gym.envs.metadrive.application import MetaDriveApplication
from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.envs.metadrive.start import NOMINAL, DriveStart
from sada_gym.envs.metadrive.world.engine import engine
from sada_gym.foundations.determinism import one_thread

pytestmark = needs("metadrive-simulator")

START = DriveStart({**NOMINAL, "traffic_density": 0.1}, 5_001, 0)
STEPS, ONE = 100, np.array([0])
FOUND: dict[str, float] = {}


def test_ours(benchmark):
    policy = MetaDriveApplication().policy

    def drive():
        episodes = DriveEpisodes([START])
        policy.start(1)
        for _ in range(STEPS):
            episodes.step(ONE, policy.act(episodes, ONE))
            episodes.ending[0] = 0  # the same number of steps whatever happens

    with one_thread():
        benchmark.pedantic(drive, rounds=5, warmup_rounds=1)
    FOUND["ms a step"] = 1000 * statistics.median(benchmark.stats.stats.data) / STEPS


@pytest.mark.parametrize("lidars", [1, 2])
def test_its_own_loop(benchmark, lidars):
    from metadrive.examples import expert

    def drive():
        engine().begin(START)
        env = engine().env
        for _ in range(STEPS):
            action = expert(env.agent, deterministic=True) if lidars == 2 else [0.0, 0.3]
            env.step(action)

    with one_thread():
        benchmark.pedantic(drive, rounds=5, warmup_rounds=1)
    what = "of its own loop with its expert" if lidars == 2 else "of its own loop without agent"
    FOUND[f"ms a step {what}"] = 1000 * statistics.median(benchmark.stats.stats.data) / STEPS


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: MetaDrive")
        for name, figure in FOUND.items():
            print(f"{name:>45}: {figure:.2f}")
