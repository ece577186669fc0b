"""Environments with costly constructors, kept and made anew, against a plain loop: `make bench`.

The plain loop resets one environment; processor time a step is compared. No test fails on a time.
"""

import time

import gymnasium as gym
import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import ActionDelay, Attribute
from sada_gym.foundations.determinism import one_thread

WORLDS, EPISODES, ROUNDS = 24, 24, 3
DELAY = {"delay": ActionDelay(0, 2, integer=True)}
MASS = {"mass": Attribute(0.5, 2.0, paths="model.body_mass[1]", factor=True)}
CASES = {
    "Blackjack-v1": (None, DELAY, 0, 10),
    "PandaReach-v3": ("panda_gym", DELAY, np.full(3, 0.3, np.float32), None),
    "PointMaze_UMaze-v3": ("gymnasium_robotics", DELAY, np.full(2, 0.5, np.float32), 100),
    "Ant-v5": ("mujoco", MASS, np.zeros(8, np.float32), 100),
}
FOUND: dict[str, str] = {}


def loop(env, action):
    steps = 0
    for seed in range(EPISODES):
        env.reset(seed=seed)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(action)
            ended, steps = terminated or truncated, steps + 1
    return steps


@pytest.mark.parametrize("name", CASES)
def test_a_step(name):
    package, parameters, action, limit = CASES[name]
    if package is not None:
        module = pytest.importorskip(package, reason=f"pip install {package}")
        if name not in gym.registry:
            gym.register_envs(module)
    ratios = {reuse: [] for reuse in (False, True)}
    for reuse in ratios:
        application = GymnasiumApplication(
            name,
            agent=lambda _: action,
            parameters=parameters,
            score=("return", -1_000.0, 1_000.0),
            fooling_threshold=0.5,
            max_steps=limit,
            reuse=reuse,
        )
        mu = np.random.default_rng(0).uniform(-1, 1, (WORLDS, 1)).astype(np.float32)
        application.evaluate(mu, range(WORLDS))
        with one_thread():
            for _ in range(ROUNDS):
                began = time.process_time()
                infos = application.evaluate(mu, range(WORLDS)).infos
                between = time.process_time()
                steps = loop(gym.make(name, max_episode_steps=limit), action)
                ours = (between - began) / sum(info["length"] for info in infos)
                ratios[reuse].append(ours / ((time.process_time() - between) / steps))
    made, kept = (np.median(ratios[reuse]) for reuse in (False, True))
    FOUND[name] = f"made anew {made:.2f}, reuse=True {kept:.2f}"


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: a step under attack, as a share of a plain loop's")
        for name, figure in FOUND.items():
            print(f"{name:>45}: {figure}")
