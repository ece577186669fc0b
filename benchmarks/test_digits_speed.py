"""The speed of the digits and of the pixel attack: `make bench`. No test fails on a time.

The aim is 10,000 evaluations a second in a batch on one core. Processor time is measured, so that a
machine with other work to do gives nearly the same.
"""

import statistics
import time

import gymnasium as gym
import numpy as np
import pytest
import torch

import sada_gym

pytestmark = pytest.mark.benchmark(timer=time.process_time)

BATCH = 1_000
MEDIANS: dict[str, float] = {}
"""Seconds an evaluation, by what was measured."""


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def record(benchmark, name, count):
    MEDIANS[name] = statistics.median(benchmark.stats.stats.data) / count
    benchmark.extra_info["a second"] = round(1 / MEDIANS[name])


def worlds(application, count=BATCH):
    rng = np.random.default_rng(0)
    mu = rng.uniform(-1, 1, (count, len(application.parameters))).astype(np.float32)
    return mu, rng.integers(2**31, size=count).tolist()


@pytest.mark.parametrize("env_id", ["SADA-Digits-v0", "SADA-Digits-3-v0", "SADA-Pixel-v0"])
def test_batch(benchmark, env_id):
    application = sada_gym.make_application(env_id)
    benchmark.pedantic(application.evaluate, worlds(application), rounds=20, warmup_rounds=2)
    record(benchmark, f"{env_id}, batch of {BATCH:,}", BATCH)


def test_network_alone(benchmark):
    application = sada_gym.make_application("SADA-Digits-v0")
    images = np.zeros((BATCH, 8, 8), np.float32)
    classify = application._classifier.act
    benchmark.pedantic(classify, (images,), rounds=20, warmup_rounds=2)
    record(benchmark, "the network alone", BATCH)


def test_scalar_step(benchmark):
    env = gym.make("SADA-Digits-v0").unwrapped
    mu, _ = worlds(env.application, 100)

    def loop():
        for row in mu:
            env.reset()
            env.step(row)

    benchmark.pedantic(loop, rounds=5, warmup_rounds=1)
    record(benchmark, "scalar step", len(mu))


def test_ratios(capsys):
    """Print what ran."""
    with capsys.disabled():
        print("\n\n| what | us each | a second |\n| --- | --- | --- |")
        for name, seconds in MEDIANS.items():
            print(f"| {name} | {1e6 * seconds:.0f} | {1 / seconds:,.0f} |")
