"""`sac` and `td3`: actor-critics that learn from all queries, by Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from torch import Tensor

from sada_gym.adversaries.models.mixture import Array
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl import PolicySteps
from sada_gym.adversaries.rl_sb3 import SB3Adversary, SB3Options
from sada_gym.evaluations import Evaluations


@dataclass(frozen=True)
class OffPolicyOptions(SB3Options):
    """The options of `sac` and `td3` that they share, beside those of `SB3Options`.

    Attributes:
        updates: Number of steps of Adam for each query.
        batch: Number of queries in a step of Adam.
    """

    updates: float = option(0.5, 0, 100, inside=True)
    batch: int = option(128, 1, 100_000)


class OffPolicyAdversary(SB3Adversary):
    """An adversary of Stable-Baselines3 that learns from all queries, the uniform ones included."""

    options: OffPolicyOptions

    def _settings(self, budget: int) -> dict[str, Any]:
        return {"buffer_size": budget}

    def _learn_uniform(self, queries: Evaluations, rewards: Array) -> None:
        mu = queries.mu.astype(np.float64)
        start = np.zeros_like(mu)
        if self.options.starts == "uniform":  # an action reaches no further than 1
            start = self.rng.uniform(np.maximum(mu - 1.0, -1.0), np.minimum(mu + 1.0, 1.0))
        self._remember(PolicySteps(start, mu - start), rewards)

    def _learn(self, steps: PolicySteps, rewards: Array) -> bool:
        self._remember(steps, rewards)
        updates = max(1, round(self.options.updates * self.options.rollout))
        return self._update(gradient_steps=updates, batch_size=self.options.batch)

    def _remember(self, steps: PolicySteps, rewards: Array) -> None:
        over = np.ones(1)
        for start, action, reward in zip(steps.start, steps.action, rewards, strict=True):
            self._model.replay_buffer.add(start, start, action, reward, over, [{}])


@dataclass(frozen=True)
class SACOptions(OffPolicyOptions):
    """The options of `sac`, beside those of `OffPolicyOptions`.

    Attributes:
        dissimilarity: The weight of the bonus for failures far from those already found.
        entropy: The temperature: the reward for each nat of the policy's entropy.
    """

    dissimilarity: float = option(0.5, 0, 100)
    entropy: float = option(0.05, 0, 100)


class SAC(OffPolicyAdversary):
    """A Gaussian policy, squashed into the box, that climbs a critic of all queries so far.

    This is the soft actor-critic (Haarnoja et al. 2018) by Stable-Baselines3, with a fixed
    temperature: at its optimum an action's density is proportional to exp(reward / temperature), as
    far as a squashed Gaussian allows. See `SACOptions`.
    """

    name: ClassVar[str] = "sac"
    algorithm = "SAC"
    options_class = SACOptions
    presets: ClassVar[Mapping[str, SACOptions]] = {
        "default": SACOptions(),
        "plain": SACOptions(starts="centre", dissimilarity=0.0),
    }
    options: SACOptions

    def _settings(self, budget: int) -> dict[str, Any]:
        return {**super()._settings(budget), "ent_coef": self.options.entropy}

    def _moments(self, start: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_deviation, _ = self._model.actor.get_action_dist_params(start)
        return mean, log_deviation.exp()

    def _squash(self, drawn: Array) -> Array:
        return np.tanh(drawn)


@dataclass(frozen=True)
class TD3Options(OffPolicyOptions):
    """The options of `td3`, beside those of `OffPolicyOptions`.

    Attributes:
        noise: The standard deviation of the noise added to every action, in training and in
            samples. It is this policy's only entropy.
    """

    updates: float = option(1.0, 0, 100, inside=True)
    noise: float = option(0.05, 0, 10, inside=True)


class TD3(OffPolicyAdversary):
    """A deterministic policy that climbs a critic of all queries, and Gaussian noise around it.

    This is twin delayed deterministic policy gradients (Fujimoto, van Hoof & Meger 2018) by
    Stable-Baselines3. A deterministic policy is not a distribution, so samples are its actions with
    the noise that it explores with. See `TD3Options`.
    """

    name: ClassVar[str] = "td3"
    algorithm = "TD3"
    options_class = TD3Options
    presets: ClassVar[Mapping[str, TD3Options]] = {
        "default": TD3Options(),
        "plain": TD3Options(starts="centre"),
    }
    options: TD3Options

    def _moments(self, start: Tensor) -> tuple[Tensor, Tensor]:
        action = self._model.actor(start)
        return action, action.new_full(action.shape, self.options.noise)
