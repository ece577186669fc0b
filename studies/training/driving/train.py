"""Train a driver: `python -m studies.training.driving.train cil --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured on the benchmark's tasks, and
written with a model card to --out. With --steps it is a trial: nothing is measured, and no card is
written. The shipped drivers' names and SHA-256 stand in `sada_gym/envs/driving/card.py`.
"""

from __future__ import annotations

from stable_baselines3 import PPO

from sada_gym.envs.driving.agent.network import save
from sada_gym.envs.driving.episodes import DriveDistribution
from sada_gym.foundations.determinism import one_thread
from studies.training.common import Imitation, Recipe, Reinforcement, Script
from studies.training.driving.evaluate import measure, table
from studies.training.driving.imitation import imitate
from studies.training.driving.recipe import RECIPES
from studies.training.driving.reinforcement import reinforce


def train(recipe: Recipe[DriveDistribution], *, seed: int) -> PPO:
    """Train a driver by its recipe, in one thread: more would give other last bits."""
    with one_thread():
        if isinstance(recipe, Imitation):
            return imitate(recipe, seed=seed)
        return reinforce(recipe, seed=seed)


def describe(recipe: Recipe[DriveDistribution]) -> str:
    """Say what a driver of a recipe is and what it learnt from, in Markdown."""
    how = "imitation of a privileged expert (DAgger)"
    if isinstance(recipe, Reinforcement):
        how = f"PPO on the driving task, from the weights of {recipe.initial_agent or 'nothing'}"
    return f"""A driver that steers by camera, speed and command
(`sada_gym/envs/driving/agent/network.py`), held in a Stable-Baselines3 PPO. It learnt
by {how},
in the training town; the benchmark's routes lie in another. It has never seen a photograph, and it
is not CARLA's."""


SCRIPT = Script(
    module="studies.training.driving.train",
    description=__doc__,
    recipes=RECIPES,
    unit="cars",
    train=train,
    save=save,
    measure=lambda driver, seed: table(measure(driver, seed=seed)),
    describe=describe,
    training="{minutes:.0f} minutes of one core, driving included",
    measured="""Measured by
`python -m studies.training.driving.evaluate {name} --seed {seed}`:
the five routes at the default camera in each weather from ten starts, the task's own and nine up to
0.3 m and 3° beside it; and uniform mu, fooled where Q <= 0.6.""",
)


def main() -> None:
    """Train, measure, write."""
    SCRIPT.run()


if __name__ == "__main__":
    main()
