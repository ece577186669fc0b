"""`ppo`: proximal policy optimisation (Schulman et al. 2017), by Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from sada_gym.adversaries.models.mixture import Array
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl import PolicySteps
from sada_gym.adversaries.rl_sb3 import SB3Adversary, SB3Options


@dataclass(frozen=True)
class PPOOptions(SB3Options):
    """The options of `ppo`, beside those of `SB3Options`.

    Attributes:
        epochs: Number of steps of Adam on each rollout.
        log_deviation: The logarithm of the standard deviation that the Gaussian starts with.
        entropy: The weight of the policy's entropy in the loss.
    """

    rollout: int = option(50, 2, 100_000)
    epochs: int = option(30, 1, 1_000)
    log_deviation: float = option(-1.0, -10, 2)
    entropy: float = option(0.0, 0, 100)


class PPO(SB3Adversary):
    """A Gaussian policy that PPO improves, rollout after rollout, on the latest one alone.

    This is proximal policy optimisation (Schulman et al. 2017) by Stable-Baselines3. It uses only
    the order of the uniform queries' scores, because they are no actions of the policy. See
    `PPOOptions`.
    """

    name: ClassVar[str] = "ppo"
    algorithm = "PPO"
    options_class = PPOOptions
    presets: ClassVar[Mapping[str, PPOOptions]] = {
        "default": PPOOptions(),
        "plain": PPOOptions(starts="centre", log_deviation=0.0),
    }
    options: PPOOptions

    def _settings(self, budget: int) -> dict[str, Any]:  # noqa: ARG002 - it forgets them
        o = self.options
        return {
            "policy_kwargs": {"net_arch": list(o.hidden), "log_std_init": o.log_deviation},
            "n_steps": o.rollout,
            "batch_size": o.rollout,
            "n_epochs": o.epochs,
            "ent_coef": o.entropy,
        }

    def _moments(self, start: Tensor) -> tuple[Tensor, Tensor]:
        normal = self._model.policy.get_distribution(start).distribution
        return normal.mean, normal.stddev

    def _learn(self, steps: PolicySteps, rewards: Array) -> bool:
        rows = steps.start, steps.action
        tensors = (torch.as_tensor(array, dtype=torch.float32) for array in rows)
        with torch.no_grad():
            values, log_densities, _ = self._model.policy.evaluate_actions(*tensors)
        buffer = self._model.rollout_buffer
        buffer.reset()
        begun = np.ones(1)
        for start, action, reward, value, log_density in zip(
            *rows, rewards, values, log_densities, strict=True
        ):
            buffer.add(start, action, reward, begun, value, log_density)
        buffer.compute_returns_and_advantage(last_values=torch.zeros(1), dones=np.ones(1))
        return self._update()
