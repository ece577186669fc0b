"""`td3`: twin delayed deterministic policy gradients (Fujimoto et al. 2018), by SB3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl_sb3 import OffPolicyAdversary, OffPolicyOptions

if TYPE_CHECKING:
    from torch import Tensor


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
    the noise that it explores with.
    See `TD3Options`.
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
