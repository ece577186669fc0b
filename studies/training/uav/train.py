"""Train a pilot: `python -m studies.training.uav.train waypoint-pid --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured, and written with a model card to
--out. With --steps it is a trial: nothing is measured, and no card is written. The shipped pilots'
names and SHA-256 stand in `sada_gym/envs/uav/card.py`.
"""

from __future__ import annotations

from stable_baselines3 import PPO

from sada_gym.envs.uav.agent.network import WaypointNetwork, save
from sada_gym.envs.uav.episodes import RaceDistribution
from sada_gym.envs.uav.world.guidance import SPEED_M_S
from sada_gym.foundations.determinism import one_thread
from studies.training.common import Imitation, Recipe, Reinforcement, Script
from studies.training.uav.evaluate import NEAR, measure, table
from studies.training.uav.imitation import imitate
from studies.training.uav.recipe import MILD, RECIPES, WIDE
from studies.training.uav.reinforcement import reinforce

_DESCRIPTIONS = {
    Imitation: f"""A perception network (`sada_gym/envs/uav/agent/network.py`) that says from the
drone's camera, attitude, velocity and turning where the next gate is and in which direction it is
passed. The guidance flies there at {SPEED_M_S:g} m/s. It learnt by DAgger from the true places of
the gates, on mild tracks alone: mu of at most {MILD.spread:g}. It has never seen a photograph.""",
    Reinforcement: f"""A small network that gets the places of the next two gates, in the drone's
own frame: it has no camera. It learnt to fly by PPO on `SADA-RacingTask-v0`, from scratch, on
tracks with mu of at most {WIDE.spread:g}.""",
}


def train(recipe: Recipe[RaceDistribution], *, seed: int) -> WaypointNetwork | PPO:
    """Train a pilot by its recipe, in one thread: more would give other last bits."""
    with one_thread():
        if isinstance(recipe, Imitation):
            return imitate(recipe, seed=seed)
        return reinforce(recipe, seed=seed)


SCRIPT = Script(
    module="studies.training.uav.train",
    description=__doc__,
    recipes=RECIPES,
    unit="drones",
    train=train,
    save=save,
    measure=lambda pilot, seed: table(measure(pilot, seed=seed)),
    describe=lambda recipe: _DESCRIPTIONS[type(recipe)],
    training="{minutes:.1f} minutes of one core, flights included",
    measured=f"""Measured by
`python -m studies.training.uav.evaluate FILE --seed {{seed}}`:
the undisturbed track with 32 seeds; 100 mild tracks that the training did not see; and 500
uniform mu, fooled where Q <= 0.7, beside the privileged pilot on the same tracks. Those that fooled
are flown once more with other seeds: again as they are, and near, moved by {NEAR:g} (normal).""",
)


def main() -> None:
    """Train, measure, write."""
    SCRIPT.run()


if __name__ == "__main__":
    main()
