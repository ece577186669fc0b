"""Find where a balancer drops its pole, train it there, and attack it again: twice.

    python examples/fix_cartpole.py

It takes some minutes. The training goes on with one model: each round attacks the model as it is,
and the environments take the new adversary as the source of half of their worlds.
"""

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from sada_gym import FailureCurriculum, GymnasiumApplication, Run, attack
from sada_gym.envs.wrapped import ObservationDelay

BUDGET = 1_000
TRAINING_STEPS = 60_000


def make_application(agent: PPO) -> GymnasiumApplication:
    """Q is the share of 500 steps for which the pole stays up."""
    return GymnasiumApplication(
        "CartPole-v1",
        agent=agent,
        parameters={
            "length": (0.25, 1.0),
            "gravity": (4.9, 19.6),
            "force_mag": (5.0, 20.0),
            "delay": ObservationDelay(0, 2, unit="steps"),
        },
        derived={"polemass_length": "masspole * length"},
        score=("length", 500),
        fooling_threshold=0.5,
    )


def find_failures(agent: PPO, number: int) -> Run:
    """Attack the agent as it is, and say how often it fails."""
    folder = f"runs/fix-cartpole/{number}"
    application = make_application(agent)
    run = attack(application, "level-set", budget=BUDGET, out=folder, resume=True)
    print(f"round {number}: {run.result.afr:.0%} of the new worlds fool the agent")
    return run


def main() -> None:
    """Train in the ordinary CartPole, then in two rounds where it fails."""
    torch.set_num_threads(1)  # small networks train several times faster in one thread
    agent = PPO(
        "MlpPolicy",
        make_vec_env("CartPole-v1", n_envs=8, seed=0),
        n_steps=128,
        gamma=0.98,
        seed=0,
        device="cpu",
    )
    agent.learn(TRAINING_STEPS)
    # the environments know what mu sets by the application; its agent does not matter
    application = make_application(agent)
    env = make_vec_env(lambda: FailureCurriculum(application), n_envs=8, seed=1)
    agent.set_env(env)
    for number in range(2):
        found = find_failures(agent, number)
        env.env_method("set_source", str(found.folder))
        agent.learn(TRAINING_STEPS)
    find_failures(agent, 2)
    agent.save("runs/fix-cartpole/fixed.zip")


if __name__ == "__main__":
    main()
