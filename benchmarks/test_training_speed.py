"""What adversaries cost at the paper's N beside their limits: `make bench`. No test fails on it.

`bayesian`, whose steps are one by one, has a file of its own.

They compute in one thread. Each runs in a process of its own, whose peak memory is measured.
"""

import resource
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from sada_gym.adversaries import make
from sada_gym.adversaries.models import exact_gp
from sada_gym.evaluation.oracle import Oracle
from sada_gym.testing.processes import in_fresh_process

N, DIMENSION, SAMPLES = 20_000, 8, 250
FEW, MANY_DIMENSIONS, FEW_LIMIT_S = 1_000, 10, 25.0
"""`level-set` has a limit for few queries, too."""
_OTHERS = "gaussian gmm10 gmm50 bbgan bbgan-boost cross-entropy smc cma-mae reinforce level-set"
LIMITS = {"svm": (300.0, 4.0), "gp": (120.0, 4.0)} | dict.fromkeys(_OTHERS.split(), (60.0, 4.0))
LIMITS |= dict.fromkeys(("ppo", "sac", "td3"), (300.0, 4.0))
"""Seconds on two cores, and GiB."""


@dataclass(frozen=True)
class Cost:
    """What training and sampling took.

    Attributes:
        wall_s: Seconds of training by the clock.
        process_s: Seconds of training by the processor.
        sample_s: Seconds of sampling by the processor.
        memory_gib: Peak memory of the process.
    """

    wall_s: float
    process_s: float
    sample_s: float
    memory_gib: float


COSTS: dict[str, Cost] = {}
GP_RATIO = 2.0
"""How many times as long as `gp`'s solver a factorisation should take, at least."""


def landscape(mu):
    """Waves under noise, so that scores spread over [0, 1] and no surrogate can be smooth."""
    rng = np.random.default_rng(0)
    directions, phases = 1.5 * rng.normal(size=(mu.shape[1], 40)), rng.uniform(0.0, 6.3, 40)
    height = np.cos(mu @ directions + phases).sum(axis=1) / 3.0 + rng.normal(size=len(mu))
    return 1.0 / (1.0 + np.exp(-height))


def cost(name, dimension=DIMENSION, queries=N):
    adversary = make(name, dimension, seed=0)
    oracle = Oracle(landscape, dimension=dimension, threshold=0.3, budget=queries)
    wall, process = time.perf_counter(), time.process_time()
    adversary.train(oracle)
    wall, process = time.perf_counter() - wall, time.process_time() - process
    sample = time.process_time()
    adversary.sample(SAMPLES)
    sample = time.process_time() - sample
    unit = 2**30 if sys.platform == "darwin" else 2**20  # getrusage counts bytes there, KiB here
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    return Cost(wall, process, sample, peak)


@pytest.mark.parametrize("name", LIMITS)
def test_training(benchmark, name):
    COSTS[name] = benchmark.pedantic(in_fresh_process, (cost, name), {"home": Cost}, rounds=1)
    benchmark.extra_info |= vars(COSTS[name])


def test_level_set_of_few_queries(benchmark, capsys):
    arguments = ("level-set", MANY_DIMENSIONS, FEW)
    spent = benchmark.pedantic(in_fresh_process, (cost, *arguments), {"home": Cost}, rounds=1)
    benchmark.extra_info |= vars(spent)
    with capsys.disabled():
        print(
            f"\n\nlevel-set, {FEW} queries in {MANY_DIMENSIONS} dimensions: {spent.wall_s:.1f} s, "
            f"{spent.process_s:.1f} s of the processor (at most {FEW_LIMIT_S:.0f})"
        )


def solver_seconds(max_factorised):
    exact_gp._MOST_FACTORISED = max_factorised  # the process is its own
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, (N, DIMENSION))
    kernel = exact_gp.Kernel(np.full(DIMENSION, 0.8), 1.0, exact_gp._NOISE_BOUNDS[0])
    start = time.process_time()
    with threadpool_limits(1):
        exact_gp.fit_weights(kernel, x, rng.normal(size=N))
    return time.process_time() - start


def test_solver_of_gp(capsys):
    """Print how many times as long a factorisation takes, at the least noise: the hardest case."""
    ours, theirs = (in_fresh_process(solver_seconds, most, home=Cost) for most in (0, N))
    with capsys.disabled():
        print(f"\n\nsolving for the weights of gp: {ours:.1f} s, by a factorisation {theirs:.1f} s")
        print(f"ratio: {theirs / ours:.1f} (at least {GP_RATIO})")


def test_limits(capsys):
    """Print what ran."""
    with capsys.disabled():
        print(f"\n\nN = {N}, d = {DIMENSION}, {SAMPLES} samples")
        print("| what | wall s | process s | limit s | sample s | GiB | limit GiB |")
        print("| --- | --- | --- | --- | --- | --- | --- |")
        for name, c in COSTS.items():
            seconds, gib = LIMITS[name]
            print(
                f"| {name} | {c.wall_s:.0f} | {c.process_s:.0f} | {seconds:.0f} "
                f"| {c.sample_s:.1f} | {c.memory_gib:.2f} | {gib:.0f} |"
            )
