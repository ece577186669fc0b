"""Train PPO on LunarLander-v3, then learn in which gravity, wind and latency it does not land.

    pip install -c constraints.txt '.[examples]'    # Box2D
    python examples/lunar_lander.py

The training takes some minutes of one core and writes lander.zip beside this file; a second run
uses it. The agent is trained without wind. lunar_lander.toml says the same for the command line.
"""

from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import Keyword, ObservationDelay

ZIP = Path(__file__).with_name("lander.zip")
TRAINING_STEPS = 1_000_000


def train() -> None:
    """Train an agent on the ordinary LunarLander-v3 and save it."""
    torch.set_num_threads(1)  # small networks train several times faster in one thread
    agent = PPO(
        "MlpPolicy",
        make_vec_env("LunarLander-v3", n_envs=16, seed=0),
        n_steps=1024,
        n_epochs=4,
        gamma=0.999,
        gae_lambda=0.98,
        ent_coef=0.01,
        seed=0,
        device="cpu",
    )
    agent.learn(TRAINING_STEPS).save(ZIP)


def make_application() -> GymnasiumApplication:
    """Q is the return between -300 and 300; a return of 0 or less means that it did not land."""
    return GymnasiumApplication(
        "LunarLander-v3",
        agent=ZIP,
        parameters={
            "gravity": Keyword(-11.9, -4.0, unit="m/s²"),
            "wind_power": (0.0, 20.0),
            "turbulence_power": (0.0, 2.0),
            "delay": ObservationDelay(0, 5, unit="steps"),  # of 0.02 s each
        },
        score=("return", -300.0, 300.0),
        fooling_threshold=0.5,
        env_kwargs={"enable_wind": True},
    )


def main() -> None:
    """Train the agent if need be, attack it, and say how often it fails."""
    if not ZIP.exists():
        train()
    run = attack(
        make_application(), "level-set", budget=1_000, seed=0, out="runs/lunar-lander", resume=True
    )
    print(f"{run.result.afr:.0%} of the new worlds fool the agent")
    print(f"pictures of them: {run.folder}/fooled.png")


if __name__ == "__main__":
    main()
