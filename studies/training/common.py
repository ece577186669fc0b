"""The training scripts share these: recipes, options, PPO's set-up and report, the model card."""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule, safe_mean
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from sada_gym.foundations.determinism import generators_kept
from sada_gym.foundations.sb3_vec_env import SB3VecEnv

DistributionT = TypeVar("DistributionT")
"""What episodes are drawn from: an application's `StartDistribution`."""


@dataclass(frozen=True)
class Imitation(Generic[DistributionT]):
    """Settings of an imitation by DAgger (Ross, Gordon, Bagnell 2011).

    Attributes:
        distribution: What episodes are drawn from.
        lockstep: The number of episodes that run at a time.
        rounds: How often episodes run and the learner is fitted; the expert acts in the first.
        steps: How many steps are gathered in a round.
        epochs: Passes over the examples after a round.
        last_epochs: Passes over the examples after the last round.
        batch: Rows of a gradient step.
        rate: The highest learning rate of each fitting's one-cycle schedule (Adam).
        light_jitter: How much each training image's brightness and tint are changed.
    """

    distribution: DistributionT
    lockstep: int
    rounds: int
    steps: int
    epochs: int
    last_epochs: int
    batch: int
    rate: float
    light_jitter: float


@dataclass(frozen=True)
class Reinforcement(Generic[DistributionT]):
    """Settings of a training by PPO (Schulman et al. 2017).

    Attributes:
        distribution: What episodes are drawn from.
        lockstep: The number of episodes that run at a time.
        steps: How many steps the training takes in all.
        rollout: Steps of each episode between two updates.
        batch: Rows of a gradient step.
        epochs: Passes over a rollout.
        rate: The learning rate at the beginning; it falls to nothing.
        discount: What a reward one step later is worth.
        initial_agent: The shipped agent whose weights it starts from; None starts from scratch.
        value_steps: In so many steps at first only the value is learnt and the policy is kept: an
            imitator knows no values, and updates by wrong ones would spoil its policy.
    """

    distribution: DistributionT
    lockstep: int
    steps: int
    rollout: int
    batch: int
    epochs: int
    rate: float
    discount: float
    initial_agent: str | None = None
    value_steps: int = 0


Recipe = Imitation[DistributionT] | Reinforcement[DistributionT]


@dataclass(frozen=True)
class Options(Generic[DistributionT]):
    """What a training script was asked for.

    Attributes:
        name: The recipe's name.
        recipe: How to train, with as many steps as were asked for.
        seed: Fixes the training.
        out: Folder for weights and card.
        trial: Whether other steps than the recipe's were asked for.
    """

    name: str
    recipe: Imitation[DistributionT] | Reinforcement[DistributionT]
    seed: int
    out: Path
    trial: bool

    @property
    def weights(self) -> Path:
        """The file of weights to write."""
        return self.out / f"{self.name}.safetensors"


def parse_options(
    description: str | None, recipes: Mapping[str, Recipe[DistributionT]], unit: str
) -> Options[DistributionT]:
    """Read a training script's options; end the script with a sentence if they cannot be used.

    Args:
        description: The script's docstring.
        recipes: All recipes by name.
        unit: What takes one step at a time, such as `cars`.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("name", choices=list(recipes))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, help="fewer, to try the script out")
    parser.add_argument("--out", type=Path, required=True, help="folder for weights and card")
    given = parser.parse_args()
    recipe, steps = recipes[given.name], given.steps
    if not 0 <= given.seed < 2**31:
        parser.error(f"Expected --seed from 0 to {2**31 - 1}, got {given.seed}.")
    if steps is not None and steps < recipe.lockstep:
        parser.error(
            f"Expected --steps of at least {recipe.lockstep}, one for each of the recipe's {unit}, "
            f"got {steps}."
        )
    if steps is not None:
        recipe = replace(recipe, steps=steps)
    return Options(given.name, recipe, given.seed, given.out, steps is not None)


def parse_only_recipe(description: str | None, steps: int, out: Path) -> argparse.Namespace:
    """Read the options `steps`, `seed` and `out` of a script that has one recipe.

    Args:
        description: The script's docstring.
        steps: The recipe's; others make a trial.
        out: The folder for agent and card.
    """
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument("--steps", type=int, default=steps)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=out)
    return parser.parse_args()


def new_learner(
    new_model: Callable[..., PPO],
    tasks: gym.vector.VectorEnv[Any, Any, Any],
    settings: Reinforcement[Any],
    *,
    seed: int,
) -> PPO:
    """Make an untrained PPO with a recipe's settings.

    Args:
        new_model: Takes a seed, an environment and PPO's options.
        tasks: Inner tasks in lockstep.
        settings: The recipe.
        seed: Fixes weights and tasks.
    """
    env = VecNormalize(VecMonitor(SB3VecEnv(tasks)), norm_obs=False, gamma=settings.discount)
    env.seed(seed)
    return new_model(
        seed,
        env,
        n_steps=settings.rollout,
        batch_size=settings.batch,
        n_epochs=settings.epochs,
        learning_rate=LinearSchedule(settings.rate, 0.0, 1.0),
        gamma=settings.discount,
        ent_coef=0.0,
        target_kl=0.03,
    )


def learn(model: PPO, settings: Reinforcement[Any], *, seed: int, report: Report) -> PPO:
    """Train a PPO on its environment, which is closed afterwards."""
    with generators_kept():  # SB3 learns with the global ones
        model.set_random_seed(seed)
        model.learn(settings.steps, callback=report)
    env = model.get_env()
    assert env is not None
    env.close()
    return model


class Report(BaseCallback):
    """Prints after each rollout how the last episodes ended.

    Args:
        success: A word for those that succeeded.
    """

    def __init__(self, success: str) -> None:
        super().__init__()
        self._success = success
        self._started = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        episodes: list[dict[str, Any]] = list(self.model.ep_info_buffer or [])
        print(
            f"{self.num_timesteps:,} steps: reward {safe_mean([e['r'] for e in episodes]):.1f}, "
            f"{self._success} {safe_mean(list(self.model.ep_success_buffer or [])):.2f}, "
            f"{time.process_time() - self._started:.0f} s",
            flush=True,
        )


class ValueFirst(Report):
    """Keeps the policy as it is until values are known, and prints how episodes ended.

    Args:
        success: A word for those that succeeded.
        kept: The policy's parameters.
        value_steps: How long they are kept.
    """

    def __init__(self, success: str, kept: Sequence[nn.Parameter], value_steps: int) -> None:
        super().__init__(success)
        self._kept, self._value_steps = kept, value_steps

    def _on_rollout_start(self) -> None:
        for parameter in self._kept:
            parameter.requires_grad_(self.num_timesteps >= self._value_steps)


@dataclass(frozen=True)
class Script(Generic[DistributionT]):
    """A training script: it trains an agent, measures it, and writes weights and a model card.

    Attributes:
        module: The script's module.
        description: Its docstring.
        recipes: All recipes by name.
        unit: What takes one step at a time, such as `cars`.
        train: Takes a recipe and `seed=`, and gives the agent.
        save: Writes an agent's weights to a file.
        measure: Takes an agent and `seed=`, and gives its figures in Markdown.
        describe: Says what an agent of a recipe is and what it learnt from, in Markdown.
        training: How long the training took, and on what, with `{minutes}`.
        measured: The command that measures the agent, with `{name}` and `{seed}`, and on what.
    """

    module: str
    description: str | None
    recipes: Mapping[str, Recipe[DistributionT]]
    unit: str
    train: Callable[..., Any]
    save: Callable[[Any, Path], None]
    measure: Callable[..., str]
    describe: Callable[[Recipe[DistributionT]], str]
    training: str
    measured: str

    def run(self) -> None:
        """Train as the command line says; a trial is not measured, and gets no card."""
        options = parse_options(self.description, self.recipes, self.unit)
        started = time.process_time()
        agent = self.train(options.recipe, seed=options.seed)
        minutes = (time.process_time() - started) / 60
        options.out.mkdir(parents=True, exist_ok=True)
        self.save(agent, options.weights)
        if options.trial:
            print(f"a trial's weights: {options.weights}")
            return
        figures = self.measure(agent, seed=options.seed + 1_000)
        print(figures)
        self.write_card(options.weights, options.recipe, options.seed, minutes, figures)

    def write_card(
        self,
        weights: Path,
        recipe: Recipe[DistributionT],
        seed: int,
        minutes: float,
        figures: str,
    ) -> None:
        """Write a model card: how the agent was trained, its file's SHA-256, what it scores."""
        name = weights.stem
        ModelCard(
            name=name,
            description=self.describe(recipe),
            command=f"python -m {self.module} {name} --seed {seed} --out DIR",
            training=self.training.format(minutes=minutes),
            recipe=recipe,
            measured=self.measured.format(name=name, seed=seed + 1_000),
            figures=figures,
        ).write(weights.with_suffix(".md"), weights)


@dataclass(frozen=True)
class ModelCard:
    """How an agent was trained, and what it scores.

    Attributes:
        name: The agent's name.
        description: What the agent is and what it learnt from, in Markdown.
        command: The command that trains it anew.
        training: How long the training took, and on what.
        recipe: A dataclass; a distribution in it is written setting by setting.
        measured: The command that measured the agent, and on what it did.
        figures: What was measured, as a Markdown table.
    """

    name: str
    description: str
    command: str
    training: str
    recipe: Any
    measured: str
    figures: str

    def write(self, path: Path, weights: Path) -> None:
        """Write the card, with the SHA-256 of the file of weights."""
        digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        distribution = getattr(self.recipe, "distribution", None)
        settings = asdict(self.recipe)
        if is_dataclass(distribution):
            del settings["distribution"]
            settings |= asdict(distribution)  # type: ignore[arg-type]
        rows = "\n".join(f"| {key} | {value} |" for key, value in settings.items())
        path.write_text(
            f"""# {self.name}

{self.description}

- Command: `{self.command}`
- Training: {self.training}; the last weights, none chosen.
- File: `{weights.name}`, SHA-256 `{digest}`

| setting | value |
| --- | --- |
{rows}

{self.measured}

{self.figures}
""",
            encoding="utf-8",
        )
