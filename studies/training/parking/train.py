"""Train the agent that `studies/parking.py` attacks.

    python -m studies.training.parking.train

Soft actor-critic with hindsight experience replay (Haarnoja et al. 2018, Andrychowicz et al. 2017)
on INDAGO's parking; each episode draws a world. It writes OUT/parking.zip, the agent after the last
step; OUT/parking-log.npz, the world of each episode of the training and whether the agent failed
in it, from which INDAGO's classifier learns; and OUT/parking.md, the card.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from sada_gym.foundations.determinism import generators_kept, one_thread
from sada_gym.measures.rates import wilson_interval
from studies.agents import FOLDER
from studies.training.common import ModelCard, parse_only_recipe
from studies.training.parking.world import ParkingWorld, World

EPISODES = 1_000
_BUFFER, _SAVED_EVERY = 100_000, 5_000


@dataclass(frozen=True)
class Recipe:
    """Settings of the training; the others are Stable-Baselines3's.

    Attributes:
        steps: How many steps are taken.
        first_steps: How many steps are random at the beginning.
        batch: Rows of a gradient step; each step is followed by one.
        rate: The learning rate.
        discount: What a reward one step later is worth.
        tau: How far the target networks move with each gradient step.
        layers: The width of each hidden layer.
        relabelled: How many goals are made up for each that was set.
    """

    steps: int = 200_000
    first_steps: int = 500
    batch: int = 256
    rate: float = 1e-3
    discount: float = 0.95
    tau: float = 0.05
    layers: tuple[int, ...] = (128, 128)
    relabelled: int = 4


class Log(BaseCallback):
    """Keeps the worlds of all episodes and how they ended; saves and reports now and then.

    Args:
        unfinished: The file in which the agent is saved while it learns.
    """

    def __init__(self, unfinished: Path) -> None:
        super().__init__()
        self.worlds: list[World] = []
        self.failed: list[bool] = []
        self.ended: list[int] = []
        self._world: World | None = None
        self._unfinished = unfinished
        self._started = time.process_time()

    def _on_training_start(self) -> None:
        self._world = self._present()

    def _present(self) -> World:
        (world,) = self.training_env.get_attr("world")
        return world  # type: ignore[no-any-return]

    def _on_step(self) -> bool:
        if self.locals["dones"][0]:
            assert self._world is not None
            self.worlds.append(self._world)
            self.failed.append(not self.locals["infos"][0]["is_success"])
            self.ended.append(self.num_timesteps)
            self._world = self._present()  # the next episode has begun
        if self.num_timesteps % _SAVED_EVERY == 0:
            self.model.save(self._unfinished)
            self.write(self._unfinished.with_suffix(".npz"))
            lately = 1.0 - float(np.mean(self.failed[-100:] or [True]))
            seconds = time.process_time() - self._started
            print(f"{self.num_timesteps:,} steps: parked {lately:.2f}, {seconds:.0f} s", flush=True)
        return True

    def write(self, path: Path) -> None:
        """Write features, (n, 24), failures, (n,), and steps at which the episodes ended, (n,)."""
        np.savez_compressed(
            path,
            features=np.array([world.features for world in self.worlds], np.float32),
            failed=np.array(self.failed, np.bool_),
            ended=np.array(self.ended, np.int32),
        )


def train(recipe: Recipe, *, seed: int, unfinished: Path) -> tuple[SAC, Log]:
    """Train the agent, in one thread, and give it with the log of its training."""
    log = Log(unfinished)
    with one_thread(), generators_kept():
        model = SAC(
            "MultiInputPolicy",
            DummyVecEnv([lambda: Monitor(ParkingWorld())]),
            learning_rate=recipe.rate,
            learning_starts=recipe.first_steps,
            batch_size=recipe.batch,
            gamma=recipe.discount,
            tau=recipe.tau,
            buffer_size=_BUFFER,
            policy_kwargs={"net_arch": [*recipe.layers]},
            replay_buffer_class=HerReplayBuffer,
            # what a step was told, since a crash changes the reward of every goal
            replay_buffer_kwargs={"n_sampled_goal": recipe.relabelled, "copy_info_dict": True},
            seed=seed,
            device="cpu",
        )
        model.learn(recipe.steps, callback=log)
    return model, log


def measure(model: Any, *, seed: int, episodes: int = EPISODES) -> str:
    """Return a table in Markdown of how often the agent parks, crashes and is late."""
    env = ParkingWorld()
    parked = crashed = steps = 0
    with one_thread(), torch.no_grad():
        for episode in range(episodes):
            observation, info = env.reset(seed=seed + episode)
            ended = False
            while not ended:
                action, _ = model.predict(observation, deterministic=True)
                observation, _, terminated, truncated, info = env.step(action)
                ended = terminated or truncated
                steps += 1
            parked, crashed = parked + info["is_success"], crashed + info["crashed"]
    counts = {"parked": parked, "crashed": crashed, "late": episodes - parked - crashed}
    lines = ["| what | figure (95 % interval) |", "| --- | --- |"]
    for name, count in counts.items():
        low, high = wilson_interval(count, episodes)
        lines.append(
            f"| {name} | {count / episodes:.1%} ({low:.1%} to {high:.1%}) |".replace("%", " %")
        )
    return "\n".join([*lines, f"| steps an episode | {steps / episodes:.1f} |"])


def main() -> None:
    """Train, measure, write; a trial with other steps than the recipe's gets no card."""
    given = parse_only_recipe(__doc__, Recipe.steps, FOLDER)
    run(Recipe(steps=given.steps), given.seed, given.out)


def run(recipe: Recipe, seed: int, out: Path) -> None:
    """Train an agent, and write it, its log, and its card if the recipe is ours."""
    out.mkdir(parents=True, exist_ok=True)
    started = time.process_time()
    unfinished = out / "parking-unfinished.zip"
    model, log = train(recipe, seed=seed, unfinished=unfinished)
    minutes = (time.process_time() - started) / 60.0
    weights = out / "parking.zip"
    model.save(weights)
    for suffix in (".zip", ".npz"):
        unfinished.with_suffix(suffix).unlink(missing_ok=True)
    log.write(out / "parking-log.npz")
    if recipe != Recipe():
        print(f"a trial's agent: {weights}")
        return
    figures = measure(model, seed=seed + 10_000)
    print(figures)
    write_card(weights, recipe, seed, minutes, len(log.failed), figures)


def write_card(
    weights: Path, recipe: Recipe, seed: int, minutes: float, episodes: int, figures: str
) -> None:
    """Write the agent's card: how it was trained, its file's SHA-256, how well it parks."""
    ModelCard(
        name="parking",
        description=f"""An agent that parks a car between others, which it does not see: SAC with
hindsight experience replay on INDAGO's worlds (`studies/training/parking/world.py`).
`parking-log.npz` has the {episodes:,} worlds of its training and in which of them it failed.""",
        command=f"python -m studies.training.parking.train --seed {seed} --out DIR",
        training=f"{minutes:.0f} minutes of one core, simulation included",
        recipe=recipe,
        measured=f"""Measured by the same command in {EPISODES:,} other worlds that are drawn as in
training: parked, crashed, or neither within 100 steps.""",
        figures=figures,
    ).write(weights.with_suffix(".md"), weights)


if __name__ == "__main__":
    main()
