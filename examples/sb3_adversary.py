"""A reinforcement-learning adversary: PPO of Stable-Baselines3 proposes mu, its reward is -Q.

Run it: python examples/sb3_adversary.py
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import sada_gym
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.oracle import Oracle

ENV_ID = "SADA-Analytic-v0"
QUERIES = 8_192


def sample(model: PPO, n: int) -> np.ndarray:
    """Draw n mu from the policy, (n, d) float32: each is the first proposal of an episode."""
    first, _ = gym.make(ENV_ID).reset(seed=0)  # the same for every seed: no proposal yet
    mu, _ = model.predict(np.tile(first, (n, 1)), deterministic=False)
    return mu


def fooling_rate(mu: np.ndarray) -> str:
    """Measure mu on seeds that training never used."""
    with Oracle(ENV_ID, budget=len(mu), seed=0, stream="test") as test:
        return str(attack_fooling_rate(test(mu), test.threshold))


def main() -> None:
    """Train, then measure."""
    envs = DummyVecEnv([lambda: gym.make(ENV_ID) for _ in range(16)])
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=8,  # 128 queries an update
        batch_size=128,
        learning_rate=1e-2,
        gamma=0.0,  # an episode is one proposal
        seed=0,
        device="cpu",
    )
    print(f"before: {fooling_rate(sample(model, 250))}")
    model.learn(QUERIES)  # one step is one query
    mu = sample(model, 250)
    print(f"after:  {fooling_rate(mu)}")
    region = sada_gym.make_application(ENV_ID).fooling_region(mu)  # -1 outside
    print("samples in each of the four regions:", [int((region == i).sum()) for i in range(4)])


if __name__ == "__main__":
    main()
