"""An agent's own environment under attack, against a plain loop: `make bench`.

Both take steps of the same model; processor time a step is compared. No test fails on a time.
"""

import time

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import ObservationNoise
from sada_gym.foundations.determinism import one_thread

WORLDS, LOOP_STEPS, ROUNDS = 64, 1_500, 3
CASES = {
    "CartPole-v1": ({"gravity": (5.0, 20.0), "force_mag": (5.0, 20.0)}, ("return", 0.0, 500.0)),
    "LunarLander-v3": ({"gravity": (-11.9, -4.0)}, ("return", -500.0, 300.0)),
}
FOUND: dict[str, str] = {}


def loop(env, model):
    steps = 0
    while steps < LOOP_STEPS:
        observation, _ = env.reset(seed=steps)
        ended = False
        while not ended:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action)
            ended, steps = terminated or truncated, steps + 1
    return steps


@pytest.mark.parametrize("name", CASES)
def test_a_step(name):
    parameters, score = CASES[name]
    if name.startswith("Lunar"):
        pytest.importorskip("Box2D", reason="Box2D is not installed: pip install '.[examples]'")
    model = PPO("MlpPolicy", name, seed=0, device="cpu", n_steps=256).learn(2_048)
    application = GymnasiumApplication(
        name, agent=model, parameters=parameters, score=score, fooling_threshold=0.5
    )
    mu = np.random.default_rng(0).uniform(-1, 1, (WORLDS, len(parameters))).astype(np.float32)
    application.evaluate(mu, range(WORLDS))
    ratios = []
    with one_thread():
        for _ in range(ROUNDS):
            began = time.process_time()
            infos = application.evaluate(mu, range(WORLDS)).infos
            between = time.process_time()
            steps = loop(gym.make(name), model)
            ours = (between - began) / sum(info["length"] for info in infos)
            ratios.append(ours / ((time.process_time() - between) / steps))
    FOUND[name] = f"{np.median(ratios):.2f}"


def test_noise_on_pictures():
    ale_py = pytest.importorskip("ale_py", reason="ale-py is not installed: pip install ale-py")
    gym.register_envs(ale_py)
    rng = np.random.default_rng(0)
    noisy = ObservationNoise(0.0, 20.0).wrap(gym.make("ALE/Pong-v5"), 10.0, rng)
    ratios = []
    steps(noisy)  # compiles
    for _ in range(3 * ROUNDS):
        with_noise = steps(noisy)
        ratios.append(with_noise / steps(gym.make("ALE/Pong-v5")))
    FOUND["Pong with noise, over Pong without"] = f"{np.median(ratios):.2f}"


def steps(env):
    env.reset(seed=0)
    began = time.process_time()
    for _ in range(LOOP_STEPS // 3):
        _, _, terminated, truncated, _ = env.step(0)
        if terminated or truncated:
            env.reset()
    return time.process_time() - began


def test_the_figures(capsys):
    with capsys.disabled():
        print(f"\n{time.strftime('%F')}: a step under attack, as a share of a plain loop's")
        for name, figure in FOUND.items():
            print(f"{name:>45}: {figure}")
