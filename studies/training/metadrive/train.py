"""Train a driver: `python -m studies.training.metadrive.train metadrive-ppo --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured, and written with a model card to
--out. With --steps it is a trial: nothing is measured, and no card is written. The shipped driver's
name and SHA-256 stand in `sada_gym/envs/metadrive/card.py`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from stable_baselines3 import PPO

from sada_gym.envs.metadrive.agent.network import new_model, save
from sada_gym.envs.metadrive.start import DriveDistribution
from sada_gym.envs.metadrive.task import DriveTaskVectorEnv
from sada_gym.foundations.determinism import one_thread
from studies.training.common import Recipe, Reinforcement, Script, ValueFirst, learn, new_learner
from studies.training.metadrive.evaluate import measure, table
from studies.training.metadrive.imitation import imitate
from studies.training.metadrive.recipe import IMITATION, RECIPES

_LOG_NOISE = -1.6
"""The logarithm of the noise on actions with which PPO goes on: 0.2, for the policy can drive."""


def train(recipe: Recipe[DriveDistribution], *, seed: int) -> PPO:
    """Train a driver: it imitates, then learns by PPO; in one thread, more give other last bits."""
    assert isinstance(recipe, Reinforcement)
    tasks = DriveTaskVectorEnv(recipe.distribution, num_envs=recipe.lockstep)
    with one_thread():
        model = new_learner(new_model, tasks, recipe, seed=seed)
        imitation = replace(IMITATION, steps=min(IMITATION.steps, recipe.steps))
        imitate(model, imitation, seed=seed)
        policy: Any = model.policy
        torch.nn.init.constant_(policy.log_std, _LOG_NOISE)
        driver = [
            *policy.mlp_extractor.policy_net.parameters(),
            *policy.action_net.parameters(),
            policy.log_std,
        ]
        report = ValueFirst("arrived", driver, recipe.value_steps)
        return learn(model, recipe, seed=seed, report=report)


SCRIPT = Script(
    module="studies.training.metadrive.train",
    description=__doc__,
    recipes=RECIPES,
    unit="cars",
    train=train,
    save=save,
    measure=lambda driver, seed: table(measure(driver, seed=seed)),
    describe=lambda _: (
        """A driver that sees what MetaDrive's own expert sees
(`sada_gym/envs/metadrive/agent/network.py`). It imitates that expert by DAgger
(`studies/training/metadrive/recipe.py`), and is then trained by Stable-Baselines3's PPO on
SADA-DrivingMetaDriveTask-v0 and MetaDrive's own reward, in 5,000 scenes. The benchmark draws other
scenes."""
    ),
    training="{minutes:.0f} minutes of one core, simulation included",
    measured="""Measured by `python -m studies.training.metadrive.evaluate {name} --seed
{seed}`: nominal worlds, and uniform mu, fooled where it did not arrive.""",
)


def main() -> None:
    """Train, measure, write."""
    SCRIPT.run()


if __name__ == "__main__":
    main()
