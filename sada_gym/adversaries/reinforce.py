"""`reinforce`: the score-function gradient (Williams 1992) on a mixture of Gaussians."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from scipy.special import softmax
from torch import Tensor

from sada_gym.adversaries.fitted import Arrays, validate_array
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl import PolicySteps, RLAdversary, RLOptions
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.determinism import one_thread


@dataclass(frozen=True)
class ReinforceOptions(RLOptions):
    """The options of `reinforce`, in addition to those of `RLOptions`.

    Attributes:
        components: The number of Gaussians of the mixture.
        deviation: The standard deviation that they start with, in each dimension.
        entropy: The reward for each nat of the mixture's entropy.
    """

    learning_rate: float = option(0.05, 0, 1, inside=True)
    components: int = option(20, 1, 1_024)
    deviation: float = option(0.3, 0, 10, inside=True)
    entropy: float = option(0.05, 0, 100)


class Reinforce(RLAdversary):
    """A mixture of Gaussians whose weights, means and scales follow the score-function gradient.

    This is REINFORCE (Williams 1992) for a bandit: after each rollout, one step of Adam follows the
    mean of (reward - baseline) x gradient of log density. The baseline is the mean reward of the
    rollout's other queries (Kool, van Hoof & Welling 2019); the entropy's gradient is estimated in
    the same way. Covariances are diagonal, and samples are reflected at the box's faces. See
    `ReinforceOptions`.
    """

    name: ClassVar[str] = "reinforce"
    packages = ("scikit-learn", "torch")
    options_class = ReinforceOptions
    presets: ClassVar[Mapping[str, ReinforceOptions]] = {
        "default": ReinforceOptions(),
        "plain": ReinforceOptions(components=1, deviation=1.0, entropy=0.0),
    }
    options: ReinforceOptions

    def begin(self, budget: int) -> None:  # noqa: ARG002 - it keeps none
        o, shape = self.options, (self.options.components, self.dimension)
        means = self.rng.uniform(-1.0, 1.0, shape) if o.components > 1 else np.zeros(shape)
        start = {
            "logits": np.zeros(o.components),
            "means": means,
            "log_deviations": np.full(shape, math.log(o.deviation)),
        }
        self._parameters = {k: torch.tensor(v, requires_grad=True) for k, v in start.items()}
        self._adam = torch.optim.Adam(self._parameters.values(), o.learning_rate)

    def act(self, n: int) -> PolicySteps:
        logits, means, log_deviations = self.arrays().values()
        chosen = self.rng.choice(len(logits), n, p=softmax(logits))
        noise = self.rng.normal(size=(n, self.dimension))
        with np.errstate(over="ignore", invalid="ignore"):  # what diverged is refused by name
            action = means[chosen] + np.exp(log_deviations[chosen]) * noise
        return PolicySteps(np.zeros_like(action), action)

    def learn(self, steps: PolicySteps, rewards: Floats) -> bool:
        with one_thread():
            log_density = self._log_density(torch.as_tensor(steps.action))
            reward = torch.as_tensor(rewards) - self.options.entropy * log_density.detach()
            others = (reward.sum() - reward) / (len(reward) - 1)
            loss = -((reward - others) * log_density).mean()
            self._adam.zero_grad()
            torch.autograd.backward(loss)
            self._adam.step()
        return all(bool(parameter.isfinite().all()) for parameter in self._parameters.values())

    def _log_density(self, points: Tensor) -> Tensor:
        logits, means, log_deviations = self._parameters.values()
        scaled = (points[:, None] - means) / log_deviations.exp()
        normal = -0.5 * (scaled**2 + math.log(2.0 * math.pi)) - log_deviations
        return (normal.sum(dim=2) + logits.log_softmax(dim=0)).logsumexp(dim=1)

    def arrays(self) -> Arrays:
        return {name: value.detach().numpy() for name, value in self._parameters.items()}

    def restore(self, arrays: Arrays) -> None:
        count, d = self.options.components, self.dimension
        shapes = {"logits": (count,), "means": (count, d), "log_deviations": (count, d)}
        self._parameters = {
            k: torch.tensor(validate_array(arrays, k, *s)) for k, s in shapes.items()
        }
