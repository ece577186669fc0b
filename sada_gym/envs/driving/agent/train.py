"""Train a driver: `python -m sada_gym.envs.driving.agent.train cil --seed 0 --out DIR`.

The last weights are kept (nothing is chosen by a score), measured on the benchmark's tasks, and
written with a model card to --out. The shipped drivers' names and SHA-256 stand in
`sada_gym/agents/__init__.py`.
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
from sada_gym.envs.driving.agent.evaluate import measure, table
from sada_gym.envs.driving.agent.imitation import imitate
from sada_gym.envs.driving.agent.recipe import RECIPES, Imitation, Reinforcement
from sada_gym.envs.driving.agent.reinforcement import reinforce
from sada_gym.envs.driving.agent.weights import save


def train(recipe: Imitation | Reinforcement, *, seed: int) -> PPO:
    """Train a driver by its recipe, in one thread: more would give other last bits."""
    with one_thread():
        if isinstance(recipe, Imitation):
            return imitate(recipe, seed=seed)
        return reinforce(recipe, seed=seed)


def write_card(path: Path, name: str, seed: int, minutes: float, weights: Path, text: str) -> None:
    """Write a model card: how the driver was trained, its file's SHA-256, what it scores."""
    recipe = asdict(RECIPES[name])
    course = recipe.pop("course")
    settings = "\n".join(f"| {key} | {value} |" for key, value in (recipe | course).items())
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    how = "imitation of a privileged expert (DAgger)"
    if isinstance(RECIPES[name], Reinforcement):
        how = f"PPO on the driving task, from the weights of {recipe['begins_as'] or 'nothing'}"
    path.write_text(
        f"""# {name}

A driver that steers by camera, speed and command (`sada_gym/envs/driving/agent/network.py`), held
in a Stable-Baselines3 PPO. It learnt in the training town; the benchmark's routes lie in another.
It has never seen a photograph, and it is not CARLA's.

- Learnt by: {how}.
- Command: `python -m sada_gym.envs.driving.agent.train {name} --seed {seed} --out DIR`
- Training: {minutes:.0f} minutes of one core, driving included; the last weights, none chosen.
- File: `{weights.name}`, SHA-256 `{digest}`

| setting | value |
| --- | --- |
{settings}

Measured by `python -m sada_gym.envs.driving.agent.evaluate {name} --seed {seed + 1_000}`: the five
routes at the default camera in each weather from ten starts, the task's own and nine up to 0.3 m
and 3° beside it; and uniform mu, fooled where Q <= 0.6.

{text}
""",
        encoding="utf-8",
    )


def main() -> None:
    """Train, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=list(RECIPES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--steps", type=int, help="fewer, to try the script out: no card is written"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for weights and card")
    arguments = parser.parse_args()
    recipe = RECIPES[arguments.name]
    check_options(parser, arguments.seed, arguments.steps, least=recipe.cars, crowd="cars")
    if arguments.steps is not None:
        recipe = replace(recipe, steps=arguments.steps)
    started = time.process_time()
    model = train(recipe, seed=arguments.seed)
    minutes = (time.process_time() - started) / 60
    arguments.out.mkdir(parents=True, exist_ok=True)
    weights = arguments.out / f"{arguments.name}.safetensors"
    save(model, weights)
    if arguments.steps is not None:
        print(f"a trial's weights: {weights}")
        return
    text = table(measure(model, seed=arguments.seed + 1_000))
    print(text)
    card = arguments.out / f"{arguments.name}.md"
    write_card(card, arguments.name, arguments.seed, minutes, weights, text)


if __name__ == "__main__":
    main()
