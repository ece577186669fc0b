"""Train a robot: `python -m studies.training.robot.train ppo --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured, and written with a model card to
--out. With --steps it is a trial: nothing is measured, and no card is written. The shipped robots'
names and SHA-256 stand in `sada_gym/envs/robot/card.py`.
"""

from __future__ import annotations

from stable_baselines3 import PPO

from sada_gym.envs.robot.agent.network import new_model, save
from sada_gym.envs.robot.start import TripDistribution
from sada_gym.envs.robot.task import RobotTaskVectorEnv
from sada_gym.foundations.determinism import one_thread
from studies.training.common import Recipe, Reinforcement, Report, Script, learn, new_learner
from studies.training.robot.evaluate import measure, table
from studies.training.robot.recipe import RECIPES


def train(recipe: Recipe[TripDistribution], *, seed: int) -> PPO:
    """Train a robot by PPO, in one thread: more would give other last bits."""
    assert isinstance(recipe, Reinforcement)
    tasks = RobotTaskVectorEnv(recipe.distribution, num_envs=recipe.lockstep)
    with one_thread():
        model = new_learner(new_model, tasks, recipe, seed=seed)
        return learn(model, recipe, seed=seed, report=Report("arrived"))


SCRIPT = Script(
    module="studies.training.robot.train",
    description=__doc__,
    recipes=RECIPES,
    unit="robots",
    train=train,
    save=save,
    measure=lambda robot, seed: table(measure(robot, seed=seed)),
    describe=lambda _: (
        """A robot that drives by its lidar and the way that was planned on its map
(`sada_gym/envs/robot/agent/network.py`), trained by Stable-Baselines3's PPO on SADA-RobotTask-v0,
on 2,000 floor plans. The benchmark draws other floor plans."""
    ),
    training="{minutes:.0f} minutes of one core, simulation included",
    measured="""Measured by `python -m studies.training.robot.evaluate {name} --seed
{seed}`: nominal worlds (mu = 0), mild ones (uniform within 0.25), and uniform mu,
fooled where Q <= 0.6; the mu that fooled, again on other seeds; and the privileged driver on
uniform mu.""",
)


def main() -> None:
    """Train, measure, write."""
    SCRIPT.run()


if __name__ == "__main__":
    main()
