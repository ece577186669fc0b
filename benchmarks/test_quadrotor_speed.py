"""The quadrotor's speed: `make bench`. No test fails on a time.

The yardstick is the network code of RAPTOR's own package, on a batch of the same size.
"""

import statistics
import time

import numpy as np
import pytest
from zoo import needs

from sada_gym.envs.quadrotor.application import QuadrotorApplication
from sada_gym.envs.quadrotor.world.dynamics import STEPS
from sada_gym.foundations.determinism import one_thread

pytestmark = needs("foundation-policy", "h5py")

RNG = np.random.default_rng(0)
WORLDS = 32
MU = RNG.uniform(-0.25, 0.25, (WORLDS, 14)).astype(np.float32)
SEEDS = RNG.integers(2**31, size=WORLDS).tolist()
FOUND: dict[str, float] = {}


@pytest.mark.parametrize("count", [WORLDS, 1])
def test_evaluations(benchmark, count):
    application = QuadrotorApplication()
    application.evaluate(MU[:count], SEEDS[:count])
    with one_thread():
        benchmark.pedantic(application.evaluate, args=(MU[:count], SEEDS[:count]), rounds=5)
    median_s = statistics.median(benchmark.stats.stats.data)
    FOUND[f"ms a world, {count} at a time"] = 1000 * median_s / count


def test_the_packages_own_network(benchmark):
    from foundation_policy import Raptor

    policy, observed = Raptor(), RNG.uniform(-0.5, 0.5, (WORLDS, 22))
    policy.reset()

    def act():
        for _ in range(STEPS):
            policy.evaluate_step(observed)

    with one_thread():
        benchmark.pedantic(act, rounds=5, warmup_rounds=1)
    median_s = statistics.median(benchmark.stats.stats.data)
    FOUND["ms a world of the package's network alone"] = 1000 * median_s / WORLDS


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: the quadrotor")
        for name, figure in FOUND.items():
            print(f"{name:>45}: {figure:.2f}")
