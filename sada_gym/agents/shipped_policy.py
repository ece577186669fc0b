"""The SB3 policies of shipped agents: their weights say everything about what they do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sada_gym.determinism import generators_kept


class ShippedPolicy(MultiInputActorCriticPolicy):
    """An SB3 policy that takes no settings, so that its weights say everything about what it does.

    A subclass gives `settings` and the name of its `architecture`, for fingerprints.

    Args:
        observation_space: The task's.
        action_space: The task's.
        lr_schedule: The learning rate over the training.
        use_sde: As SB3 passes it; not used.
    """

    architecture: ClassVar[str]
    settings: ClassVar[Mapping[str, Any]]

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,  # noqa: ARG002
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, **self.settings)


def new_ppo(policy: type[ShippedPolicy], env: GymEnv, seed: int, **options: Any) -> PPO:
    """Make an untrained PPO; the seed fixes its weights, and no global generator is changed."""
    with generators_kept():
        return PPO(policy, env, seed=seed, device="cpu", **options)
