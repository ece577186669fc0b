"""The SB3 policies of shipped agents, whose weights say all that they do, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sada_gym.agents.weights import WeightsFile, load_weights, save_weights
from sada_gym.foundations.determinism import generators_kept


class ShippedPolicy(MultiInputActorCriticPolicy):
    """An SB3 policy that takes no settings, so that its weights say everything about what it does.

    A subclass gives `settings`, the name of its `architecture`, for fingerprints, and the
    `environment` on which it is trained. For files it gives the `kind` of agent, such as `driver`,
    the module that it is `trained_by`, the observations `seen`, and how else it is `built`.
    """

    architecture: ClassVar[str]
    settings: ClassVar[Mapping[str, Any]]
    environment: ClassVar[type[gym.Env[Any, Any]]]
    kind: ClassVar[str]
    trained_by: ClassVar[str]
    seen: ClassVar[spaces.Dict]
    built: ClassVar[Mapping[str, Any]]

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

    @classmethod
    def save_model(cls, model: PPO, path: Path) -> None:
        """Write a model's weights, and how their network is built."""
        save_weights(model.policy, path, cls._header())

    @classmethod
    def load_model(cls, path: Path) -> PPO:
        """Read a model's weights; raise `FileError` if the file holds none of such an agent."""
        model = cls.new_model(0)
        file = WeightsFile(path, f"the weights of a {cls.kind}", cls.kind, cls.trained_by)
        load_weights(model.policy, file, cls._header())
        # as SB3 loads a model: with an environment its pictures would be transposed by that one's
        # wrapper, into another order in memory, for which convolutions give other last bits
        model.env = None
        return model

    @classmethod
    def _header(cls) -> dict[str, Any]:
        shapes = {key: list(space.shape or ()) for key, space in sorted(cls.seen.items())}
        return {**cls.built, "observations": shapes}
