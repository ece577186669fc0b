"""The Go2's speed: `make bench`. No test fails on a time.

The yardstick is MuJoCo alone, which takes as many steps of a world with the same robot.
"""

import statistics
import time

import numpy as np
import pytest
from zoo import needs

from sada_gym.envs.go2.application import ORDINARY, Go2Application
from sada_gym.envs.go2.card import CARD
from sada_gym.envs.go2.start import STEPS, SUBSTEPS, Go2Start
from sada_gym.envs.go2.world.robot import model
from sada_gym.foundations.determinism import one_thread

pytestmark = [needs("mujoco"), pytest.mark.skipif(bool(CARD.missing), reason="")]

WORLDS = 4
FOUND: dict[str, float] = {}


@pytest.mark.parametrize("count", [WORLDS, 1])
def test_evaluations(benchmark, count):
    application = Go2Application()
    mu, seeds = np.tile(application.nominal, (count, 1)), range(count)
    application.evaluate(mu, seeds)
    with one_thread():
        benchmark.pedantic(application.evaluate, args=(mu, seeds), rounds=3)
    median_s = statistics.median(benchmark.stats.stats.data)
    FOUND[f"s a world, {count} at a time"] = median_s / count


def test_mujoco_alone(benchmark):
    import mujoco

    def walk():
        built = model(Go2Start(ORDINARY, 0))
        data = mujoco.MjData(built)
        data.qpos[2] = 0.4
        mujoco.mj_step(built, data, STEPS * SUBSTEPS)

    benchmark.pedantic(walk, rounds=3, warmup_rounds=1)
    FOUND["s a world of MuJoCo alone"] = statistics.median(benchmark.stats.stats.data)


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: the Go2")
        for name, figure in FOUND.items():
            print(f"{name:>30}: {figure:.3f}")
