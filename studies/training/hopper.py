"""Train the agent whose worst return `studies/worst_return.py` looks for.

    python -m studies.training.hopper

Proximal policy optimisation (Schulman et al. 2017) with Stable-Baselines3's settings, on
Gymnasium's Hopper-v5 as it is. It writes OUT/hopper.zip, the agent after the last step, and its
card, OUT/hopper.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import LinearSchedule, safe_mean
from stable_baselines3.common.vec_env import VecNormalize

from sada_gym.foundations.determinism import generators_kept, one_thread
from studies.agents import FOLDER
from studies.means import mean_text
from studies.training.common import ModelCard, parse_only_recipe

ENVIRONMENT = "Hopper-v5"
EPISODES = 100
_SAVED_EVERY = 20  # rollouts


@dataclass(frozen=True)
class Recipe:
    """Settings of the training; the others are Stable-Baselines3's.

    Attributes:
        steps: How many steps are taken.
        envs: The number of episodes that run at a time.
        rollout: Steps of each episode between two updates.
        rate: The learning rate at the beginning; it falls to nothing.
        discount: What a reward one step later is worth.
    """

    steps: int = 1_000_000
    envs: int = 4
    rollout: int = 512
    rate: float = 3e-4
    discount: float = 0.99


class Report(BaseCallback):
    """Prints returns and saves the agent now and then.

    Args:
        unfinished: The file in which the agent is saved while it learns.
    """

    def __init__(self, unfinished: Path) -> None:
        super().__init__()
        self._unfinished = unfinished
        self._rollouts = 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self._rollouts += 1
        if self._rollouts % _SAVED_EVERY == 0:
            self.model.save(self._unfinished)
            lately = safe_mean([e["r"] for e in self.model.ep_info_buffer or []])
            print(f"{self.num_timesteps:,} steps: return {lately:.0f}", flush=True)


def train(recipe: Recipe, *, seed: int, unfinished: Path) -> PPO:
    """Train the agent, in one thread."""
    with one_thread(), generators_kept():
        env = VecNormalize(
            make_vec_env(ENVIRONMENT, n_envs=recipe.envs, seed=seed),
            norm_obs=False,
            gamma=recipe.discount,
        )
        model = PPO(
            "MlpPolicy",
            env,
            n_steps=recipe.rollout,
            learning_rate=LinearSchedule(recipe.rate, 0.0, 1.0),
            gamma=recipe.discount,
            seed=seed,
            device="cpu",
        )
        model.learn(recipe.steps, callback=Report(unfinished))
        env.close()
    return model


def measure(model: Any, *, seed: int, episodes: int = EPISODES) -> str:
    """Return a table in Markdown of the agent's returns and the lengths of its episodes."""
    env, returns, lengths = gym.make(ENVIRONMENT), [], []
    with one_thread():
        for episode in range(episodes):
            observation, _ = env.reset(seed=seed + episode)
            gained, steps, ended = 0.0, 0, False
            while not ended:
                action, _ = model.predict(observation, deterministic=True)
                observation, reward, terminated, truncated, _ = env.step(action)
                gained, steps, ended = gained + float(reward), steps + 1, terminated or truncated
            returns.append(gained)
            lengths.append(steps)
    env.close()
    return "\n".join(
        [
            "| what | figure (95 % interval) |",
            "| --- | --- |",
            f"| mean return | {mean_text(returns, 0)} |",
            f"| lowest return | {min(returns):.0f} |",
            f"| steps an episode | {np.mean(lengths):.0f} |",
        ]
    )


def main() -> None:
    """Train, measure, write; a trial with other steps than the recipe's gets no card."""
    given = parse_only_recipe(__doc__, Recipe.steps, FOLDER)
    run(Recipe(steps=given.steps), given.seed, given.out)


def run(recipe: Recipe, seed: int, out: Path) -> None:
    """Train an agent, and write it, and its card if the recipe is ours."""
    out.mkdir(parents=True, exist_ok=True)
    started = time.process_time()
    unfinished = out / "hopper-unfinished.zip"
    model = train(recipe, seed=seed, unfinished=unfinished)
    minutes = (time.process_time() - started) / 60.0
    weights = out / "hopper.zip"
    model.save(weights, exclude=["ep_info_buffer", "ep_success_buffer"])
    unfinished.unlink(missing_ok=True)
    if recipe != Recipe():
        print(f"a trial's agent: {weights}")
        return
    figures = measure(model, seed=seed + 10_000)
    print(figures)
    ModelCard(
        name="hopper",
        description="A policy of Gymnasium's Hopper-v5, as it is: PPO with Stable-Baselines3's "
        "settings\nbut for those below.",
        command=f"python -m studies.training.hopper --seed {seed} --out DIR",
        training=f"{minutes:.0f} minutes of one core, simulation included",
        recipe=recipe,
        measured=f"Measured by the same command in {EPISODES} other episodes.",
        figures=figures,
    ).write(weights.with_suffix(".md"), weights)


if __name__ == "__main__":
    main()
