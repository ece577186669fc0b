"""The SB3 policies of shipped agents, whose weights say all that they do, and their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sada_gym.agents.weights import WeightsFile, load_weights, save_weights
from sada_gym.determinism import generators_kept


class ShippedPolicy(MultiInputActorCriticPolicy):
    """An SB3 policy that takes no settings, so that its weights say everything about what it does.

    A subclass gives `settings`, the name of its `architecture`, for fingerprints, and the
    `environment` on which it is trained.
    """

    architecture: ClassVar[str]
    settings: ClassVar[Mapping[str, Any]]
    environment: ClassVar[type[gym.Env[Any, Any]]]

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,  # noqa: ARG002
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, **self.settings)

    @classmethod
    def new_model(cls, seed: int, env: GymEnv | None = None, **options: Any) -> PPO:
        """Make an untrained PPO with this policy for `env`; no global generator is changed."""
        with generators_kept():
            return PPO(cls, env or cls.environment(), seed=seed, device="cpu", **options)


@dataclass(frozen=True)
class PolicyFiles:
    """Files of one kind of agent, such as `driver`: weights, and how their network is built.

    The module `trained_by` trains such an agent; `new_model` makes an untrained one of a seed;
    `built` is what else the weights' shapes depend on, for JSON.
    """

    kind: str
    trained_by: str
    new_model: Callable[[int], PPO]
    observation_space: spaces.Dict
    built: Mapping[str, Any]

    def save(self, model: PPO, path: Path) -> None:
        """Write a model's weights."""
        save_weights(model.policy, path, self._architecture)

    def load(self, path: Path) -> PPO:
        """Read a model's weights; raise `FileError` if the file holds none of such an agent."""
        model = self.new_model(0)
        file = WeightsFile(path, f"the weights of a {self.kind}", self.kind, self.trained_by)
        load_weights(model.policy, file, self._architecture)
        # as SB3 loads a model: with an environment its pictures would be transposed by that one's
        # wrapper, into another order in memory, for which convolutions give other last bits
        model.env = None
        return model

    @property
    def _architecture(self) -> dict[str, Any]:
        spaces_of = sorted(self.observation_space.spaces.items())
        return {
            **self.built,
            "observations": {key: list(space.shape or ()) for key, space in spaces_of},
        }
