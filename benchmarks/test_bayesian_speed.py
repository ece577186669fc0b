"""Speed of `bayesian`'s 10,000 steps, as a ratio to scikit-optimize's `gp_minimize` in one run.

Both minimise one instant function in 8 dimensions by expected improvement with a Matern 5/2 kernel,
in one thread. scikit-optimize runs 50, 100 and 200 steps (`pip install scikit-optimize`); its time
for 10,000 is extrapolated by a cubic with no negative coefficient. That flatters it: it factorises
afresh at each step, so its time grows with the fourth power in the end. Process time is measured;
no test fails on a time.
"""

import resource
import time

import numpy as np
import pytest
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from sada_gym.adversaries import make
from sada_gym.evaluation.oracle import Oracle

DIMENSION, STEPS, TARGET = 8, 10_000, 100
THEIR_STEPS = (50, 100, 200)
SECONDS: dict[tuple[str, int], float] = {}
"""Process time, by whose it is and the number of steps."""

pytestmark = [pytest.mark.benchmark(timer=time.process_time), pytest.mark.timeout(3600)]


@pytest.fixture(autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


def score(mu):
    """Return a bowl with ripples, within [0, 1]: (n,)."""
    bowl = ((mu - 0.3) ** 2).mean(axis=1) / 2
    return np.clip(bowl + 0.05 * np.sin(9 * mu).mean(axis=1) + 0.05, 0, 1)


def record(benchmark, whose, steps):
    SECONDS[whose, steps] = benchmark.stats.stats.data[0]
    benchmark.extra_info["steps a second"] = steps / SECONDS[whose, steps]


@pytest.mark.parametrize("steps", THEIR_STEPS)
def test_scikit_optimize(benchmark, steps):
    skopt = pytest.importorskip(
        "skopt", reason="the yardstick is missing: pip install scikit-optimize"
    )

    def train():
        return skopt.gp_minimize(
            lambda mu: float(score(np.array([mu]))[0]),
            [(-1.0, 1.0)] * DIMENSION,
            n_calls=steps,
            acq_func="EI",
            random_state=0,
            n_jobs=1,
        )

    found = benchmark.pedantic(train, rounds=1)
    benchmark.extra_info["lowest score"] = float(found.fun)
    record(benchmark, "scikit-optimize", steps)


@pytest.mark.parametrize("steps", [200, STEPS])
def test_bayesian(benchmark, steps):
    adversary = make("bayesian", DIMENSION, seed=0)

    def train():
        adversary.train(Oracle(score, dimension=DIMENSION, threshold=0.1, budget=steps, seed=0))

    benchmark.pedantic(train, rounds=1)
    benchmark.extra_info["lowest score"] = float(adversary.queries.score.min())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    benchmark.extra_info["peak memory of the process, GiB"] = peak / 2**20
    record(benchmark, "ours", steps)


def extrapolated(steps):
    """Return scikit-optimize's seconds for so many steps: a n + b n^2 + c n^3, none negative."""
    known, powers = np.array(THEIR_STEPS) / max(THEIR_STEPS), np.array([1, 2, 3])
    seconds = np.array([SECONDS["scikit-optimize", n] for n in THEIR_STEPS])
    # in units of what was measured: each length counts alike
    weights, _ = nnls(known[:, None] ** powers / seconds[:, None], np.ones(len(known)))
    return float(weights @ (steps / max(THEIR_STEPS)) ** powers)


def test_ratios(capsys):
    """Print the ratio."""
    if len(SECONDS) < len(THEIR_STEPS) + 2:
        pytest.skip("needs all of the other measurements of this file, scikit-optimize's too")
    with capsys.disabled():
        print("\n\n| whose | steps | seconds |\n| --- | --- | --- |")
        for (whose, steps), seconds in SECONDS.items():
            print(f"| {whose} | {steps} | {seconds:.1f} |")
        theirs = extrapolated(STEPS)
        print(f"| scikit-optimize, extrapolated | {STEPS} | {theirs:.0f} |")
        ratio = theirs / SECONDS["ours", STEPS]
        print(f"\nscikit-optimize over ours at {STEPS} steps: {ratio:.0f} (at least {TARGET})")
