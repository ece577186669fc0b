"""Driving's speed, as ratios within one run: `make bench`. No test fails on a time.

The yardstick is highway-env's own `racetrack` with its default observation, at the same policy and
simulation frequencies. What is compared is simulated seconds a second.
"""

import statistics

import gymnasium as gym
import highway_env
import numpy as np
import pytest
import torch

import sada_gym  # noqa: F401
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.episodes import (
    POLICY_HZ,
    SIMULATION_HZ,
    DriveDistribution,
    DrivingEpisodes,
)
from sada_gym.envs.driving.task import DrivingTaskVectorEnv
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.sb3_vec_env import SB3VecEnv

RNG = np.random.default_rng(0)
CARS = 320
MEDIANS: dict[str, float] = {}
"""Simulated seconds a second, by what was measured."""


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def record(benchmark, name, simulated_s):
    MEDIANS[name] = simulated_s / statistics.median(benchmark.stats.stats.data)
    benchmark.extra_info["simulated s a second"] = MEDIANS[name]


def test_racetrack(benchmark):
    gym.register_envs(highway_env)
    env = gym.make("racetrack-v1").unwrapped
    assert env.config["policy_frequency"] == POLICY_HZ
    assert env.config["simulation_frequency"] == SIMULATION_HZ
    steps = 50

    def drive():
        env.reset(seed=0)
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(RNG.uniform(-0.1, 0.1, 1).astype(np.float32))
            if terminated or truncated:
                env.reset()

    benchmark.pedantic(drive, rounds=5, warmup_rounds=1)
    record(benchmark, "racetrack", steps / POLICY_HZ)


def test_lockstep(benchmark):
    """Camera, network and dynamics of a batch, as an evaluation runs them."""
    application = DrivingApplication("navigation")
    distribution, rng = DriveDistribution("benchmark"), np.random.default_rng(0)
    steps = 20

    def setup():
        drives = DrivingEpisodes(camera("benchmark"), [distribution.draw(rng) for _ in range(CARS)])
        application.policy.start(CARS)
        return (drives,), {}

    def drive(drives):
        everyone = np.arange(CARS)
        for _ in range(steps):
            drives.step(everyone, application.policy.act(drives, everyone))

    benchmark.pedantic(drive, setup=setup, rounds=5, warmup_rounds=1)
    record(benchmark, "lockstep, camera and network included", CARS * steps / POLICY_HZ)


def test_training_environment(benchmark):
    """What SB3 trains on: camera and dynamics, without a network."""
    env = SB3VecEnv(DrivingTaskVectorEnv(num_envs=32))
    env.reset()
    steps = 40

    def drive():
        for _ in range(steps):
            env.step(np.tile([0.0, 0.5], (32, 1)))

    benchmark.pedantic(drive, rounds=5, warmup_rounds=1)
    record(benchmark, "task in a batch of 32", 32 * steps / POLICY_HZ)


@pytest.mark.parametrize("workers", [1, 2])
def test_workers(benchmark, workers):
    count = 128
    mu = np.random.default_rng(1).uniform(-1, 1, (count, 3))
    with Oracle("SADA-Driving-Straight-v0", budget=100 * count, workers=workers, seed=0) as oracle:
        benchmark.pedantic(oracle, (mu,), rounds=3, warmup_rounds=1)
    MEDIANS[f"oracle, {workers} worker(s)"] = count / statistics.median(benchmark.stats.stats.data)


def test_ratios(capsys):
    """Print the ratios of what ran."""
    wanted = (
        ("lockstep, camera and network included", "racetrack", "at least 15"),
        ("oracle, 2 worker(s)", "oracle, 1 worker(s)", "at least 1.7"),
    )
    with capsys.disabled():
        print("\n\n| what | over | ratio | target |\n| --- | --- | --- | --- |")
        for a, b, target in wanted:
            if a in MEDIANS and b in MEDIANS:
                print(f"| {a} | {b} | {MEDIANS[a] / MEDIANS[b]:.2f} | {target} |")
        print("\n| what | a second |\n| --- | --- |")
        for name, rate in MEDIANS.items():
            print(f"| {name} | {rate:.0f} |")
