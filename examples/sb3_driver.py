"""Train a driver with Stable-Baselines3 on the driving task, then attack it.

It takes half a minute. Such a short training teaches little: the driver leaves its lane at once.
"""

import gymnasium as gym
from stable_baselines3 import PPO

from sada_gym import attack
from sada_gym.sb3 import SB3VecEnv

env = SB3VecEnv(gym.make_vec("SADA-DrivingTask-v0", num_envs=16))
driver = PPO("MultiInputPolicy", env, n_steps=32, batch_size=128, seed=0, device="cpu")
driver.learn(512)

run = attack(
    "SADA-Driving-Straight-v0",
    "random",
    env_kwargs={"agent": driver},
    samples=3,
    seed=0,
    out="runs/own-driver",
    resume=True,
)
print(f"uniform worlds fool it in {100 * run.result.afr:.0f} % of cases")
