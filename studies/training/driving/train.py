"""Train a driver: `python -m studies.training.driving.train cil --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured on the benchmark's tasks, and
written with a model card to --out. With --steps it is a trial: nothing is measured, and no card is
written. The shipped drivers' names and SHA-256 stand in `sada_gym/envs/driving/card.py`.
"""

from __future__ import annotations

from pathlib import Path

from stable_baselines3 import PPO

from sada_gym.determinism import one_thread
from sada_gym.envs.driving.agent.network import save
from sada_gym.envs.driving.start_distribution import StartDistribution
from studies.training.common import Imitation, ModelCard, Recipe, Reinforcement, run_script
from studies.training.driving.evaluate import measure, table
from studies.training.driving.imitation import imitate
from studies.training.driving.recipe import RECIPES
from studies.training.driving.reinforcement import reinforce


def train(recipe: Recipe[StartDistribution], *, seed: int) -> PPO:
    """Train a driver by its recipe, in one thread: more would give other last bits."""
    with one_thread():
        if isinstance(recipe, Imitation):
            return imitate(recipe, seed=seed)
        return reinforce(recipe, seed=seed)


def write_card(
    weights: Path, recipe: Recipe[StartDistribution], seed: int, minutes: float, figures: str
) -> None:
    """Write a model card: how the driver was trained, its file's SHA-256, what it scores."""
    name = weights.stem
    how = "imitation of a privileged expert (DAgger)"
    if isinstance(recipe, Reinforcement):
        how = f"PPO on the driving task, from the weights of {recipe.initial_agent or 'nothing'}"
    ModelCard(
        name=name,
        description=f"""A driver that steers by camera, speed and command
(`sada_gym/envs/driving/agent/network.py`), held in a Stable-Baselines3 PPO. It learnt
by {how},
in the training town; the benchmark's routes lie in another. It has never seen a photograph, and it
is not CARLA's.""",
        command=f"python -m studies.training.driving.train {name} --seed {seed} --out DIR",
        training=f"{minutes:.0f} minutes of one core, driving included",
        recipe=recipe,
        measured=f"""Measured by
`python -m studies.training.driving.evaluate {name} --seed {seed + 1_000}`:
the five routes at the default camera in each weather from ten starts, the task's own and nine up to
0.3 m and 3° beside it; and uniform mu, fooled where Q <= 0.6.""",
        figures=figures,
    ).write(weights.with_suffix(".md"), weights)


def main() -> None:
    """Train, measure, write."""
    run_script(
        __doc__,
        RECIPES,
        "cars",
        train=train,
        save=save,
        measure=lambda driver, seed: table(measure(driver, seed=seed)),
        write_card=write_card,
    )


if __name__ == "__main__":
    main()
