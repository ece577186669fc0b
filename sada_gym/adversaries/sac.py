"""`sac`: the soft actor-critic (Haarnoja et al. 2018), by Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sada_gym.adversaries.models.mixture import Array
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl_sb3 import OffPolicyAdversary, OffPolicyOptions

if TYPE_CHECKING:
    from torch import Tensor


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
    far as a squashed Gaussian allows.
    See `SACOptions`.
    """

    name: ClassVar[str] = "sac"
    algorithm = "SAC"
    options_class = SACOptions
    presets: ClassVar[Mapping[str, SACOptions]] = {
        "default": SACOptions(),
        "plain": SACOptions(starts="centre", dissimilarity=0.0),
    }
    options: SACOptions

    def _settings(self, queries: int) -> dict[str, Any]:
        return {**super()._settings(queries), "ent_coef": self.options.entropy}

    def _moments(self, start: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_deviation, _ = self._model.actor.get_action_dist_params(start)
        return mean, log_deviation.exp()

    def _squash(self, drawn: Array) -> Array:
        return np.tanh(drawn)
