"""Train a pilot: `python -m sada_gym.envs.uav.agent.train waypoint-pid --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured, and written with a model card to
--out. The shipped pilots' names and SHA-256 stand in `sada_gym/agents/__init__.py`.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from dataclasses import asdict, replace
from pathlib import Path

from stable_baselines3 import PPO

from sada_gym.agents.options import check_options
from sada_gym.determinism import one_thread
from sada_gym.envs.uav.agent.evaluate import measure, table
from sada_gym.envs.uav.agent.imitation import imitate
from sada_gym.envs.uav.agent.network import WaypointNetwork
from sada_gym.envs.uav.agent.recipe import MILD, RECIPES, Imitation, Reinforcement
from sada_gym.envs.uav.agent.reinforcement import reinforce
from sada_gym.envs.uav.agent.weights import save
from sada_gym.envs.uav.world.guidance import SPEED_M_S

_WHAT = {
    Imitation: f"""A perception network (`sada_gym/envs/uav/agent/network.py`) that says from the
drone's camera, attitude, velocity and turning where the next gate is and in which direction it is
passed. The guidance flies there at {SPEED_M_S:g} m/s. It learnt by DAgger from the true places of
the gates, on mild tracks alone: mu of at most {MILD.spread:g}. It has never seen a photograph.""",
    Reinforcement: f"""A small network that is told where the next two gates are, in the drone's own
frame: it has no camera. It learnt to fly by PPO on `SADA-RacingTask-v0`, from scratch, on mild
tracks alone: mu of at most {MILD.spread:g}.""",
}


def train(recipe: Imitation | Reinforcement, *, seed: int) -> WaypointNetwork | PPO:
    """Train a pilot by its recipe, in one thread: more would give other last bits."""
    with one_thread():
        if isinstance(recipe, Imitation):
            return imitate(recipe, seed=seed)
        return reinforce(recipe, seed=seed)


def write_card(
    weights: Path, recipe: Imitation | Reinforcement, seed: int, minutes: float, text: str
) -> None:
    """Write a model card: how the pilot was trained, its file's SHA-256, what it scores."""
    name = weights.stem
    tried = "" if recipe == RECIPES[name] else f" --steps {recipe.steps}"
    settings = "\n".join(f"| {key} | {value} |" for key, value in asdict(recipe).items())
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    weights.with_suffix(".md").write_text(
        f"""# {name}

{_WHAT[type(recipe)]}

- Command: `python -m sada_gym.envs.uav.agent.train {name} --seed {seed}{tried} --out DIR`
- Training: {minutes:.1f} minutes of one core, flights included; the last weights, none chosen.
- File: `{weights.name}`, SHA-256 `{digest}`

| setting | value |
| --- | --- |
{settings}

Measured by `python -m sada_gym.envs.uav.agent.evaluate FILE --seed {seed + 1_000}`: the undisturbed
template with 32 seeds; 100 mild tracks that the training did not see; and 400 uniform mu, fooled
where Q <= 0.7, beside the privileged pilot on the same tracks.

{text}
""",
        encoding="utf-8",
    )


def main() -> None:
    """Train, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=list(RECIPES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, help="fewer, to try the script out")
    parser.add_argument("--out", type=Path, required=True, help="folder for weights and card")
    arguments = parser.parse_args()
    recipe = RECIPES[arguments.name]
    check_options(parser, arguments.seed, arguments.steps, least=recipe.drones, crowd="drones")
    if arguments.steps is not None:
        recipe = replace(recipe, steps=arguments.steps)
    started = time.process_time()
    pilot = train(recipe, seed=arguments.seed)
    minutes = (time.process_time() - started) / 60
    arguments.out.mkdir(parents=True, exist_ok=True)
    weights = arguments.out / f"{arguments.name}.safetensors"
    save(pilot, weights)
    text = table(measure(pilot, seed=arguments.seed + 1_000))
    print(text)
    write_card(weights, recipe, arguments.seed, minutes, text)


if __name__ == "__main__":
    main()
