"""Train PPO on CartPole-v1 for half a minute, then learn the worlds in which it drops the pole.

    python examples/cartpole.py

CartPole has no keywords for its physics, so that the parameters are attributes of the environment.
Its constructor computes two more attributes from them, which `derived` computes anew in each world.
"""

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import Attribute, ObservationDelay

TRAINING_STEPS = 60_000


def train() -> PPO:
    """Train an agent that keeps the pole up for all 500 steps of the ordinary CartPole-v1."""
    torch.set_num_threads(1)  # small networks train several times faster in one thread
    agent = PPO(
        "MlpPolicy",
        make_vec_env("CartPole-v1", n_envs=8, seed=0),
        n_steps=32,
        batch_size=256,
        n_epochs=20,
        gamma=0.98,
        gae_lambda=0.8,
        learning_rate=lambda left: 0.001 * left,
        clip_range=lambda left: 0.2 * left,
        seed=0,
        device="cpu",
    )
    return agent.learn(TRAINING_STEPS)


def make_application(agent: PPO) -> GymnasiumApplication:
    """Q is the share of 500 steps for which the pole stays up.

    The physics go from half to twice their usual values.
    """
    return GymnasiumApplication(
        "CartPole-v1",
        agent=agent,
        parameters={
            "length": Attribute(0.25, 1.0, unit="m"),  # from the joint to the middle of the pole
            "masspole": Attribute(0.05, 0.2, unit="kg"),
            "gravity": Attribute(4.9, 19.6, unit="m/s²"),
            "force_mag": Attribute(5.0, 20.0, unit="N"),
            "delay": ObservationDelay(0, 2, unit="steps"),  # of 0.02 s each
        },
        derived={"total_mass": "masspole + masscart", "polemass_length": "masspole * length"},
        score=("length", 500),
        fooling_threshold=0.5,
    )


def main() -> None:
    """Train the agent, attack it, and say how often it fails."""
    application = make_application(train())
    run = attack(application, "level-set", budget=1_000, seed=0, out="runs/cartpole", resume=True)
    print(f"{run.result.afr:.0%} of the new worlds fool the agent")
    print(f"pictures of them: {run.folder}/fooled.png")


if __name__ == "__main__":
    main()
