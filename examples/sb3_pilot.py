"""Train a racing pilot with Stable-Baselines3 on the racing task, then attack it.

It takes a quarter of a minute. Such a short training teaches little: the pilot misses most gates.
"""

import gymnasium as gym
from stable_baselines3 import PPO

from sada_gym import attack
from sada_gym.sb3 import SB3VecEnv

env = SB3VecEnv(gym.make_vec("SADA-RacingTask-v0", num_envs=16))
pilot = PPO("MultiInputPolicy", env, n_steps=32, batch_size=128, seed=0, device="cpu")
pilot.learn(512)

run = attack(
    "SADA-UAV-3Anchors-v0",
    "random",
    env_kwargs={"agent": pilot},
    samples=3,
    seed=0,
    out="runs/own-pilot",
    resume=True,
)
print(f"uniform tracks fool it in {100 * run.result.afr:.0f} % of cases")
