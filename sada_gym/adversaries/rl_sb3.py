"""The adapter to Stable-Baselines3: its models learn from our rollouts, by our seeds."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

from sada_gym.adversaries.fitted import Arrays, without_prefix
from sada_gym.adversaries.models.mixture import Array
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl import PolicySteps, RLAdversary, RLOptions
from sada_gym.determinism import generators_kept, one_thread


@dataclass(frozen=True)
class SB3Options(RLOptions):
    """The options of the adversaries of Stable-Baselines3, beside those of `RLOptions`.

    Attributes:
        starts: The place where episodes start: the `centre` of the box, or `uniform` in it.
        hidden: The widths of the hidden layers of each network.
    """

    starts: str = option("uniform", choices=("centre", "uniform"))
    hidden: tuple[int, ...] = option((64, 64), 1, 1_024)


class SB3Adversary(RLAdversary):
    """An adversary whose policy and update rule are those of Stable-Baselines3.

    We draw the actions, query the oracle and give rewards; then the model's own `train` improves
    the policy. So a rollout is one call of the oracle, the policy learns from the last one too, and
    the oracle never runs while Stable-Baselines3 uses the global generators.

    Where all episodes start at the centre of the box, the policy is one Gaussian. With uniform
    starts the policy observes where an episode starts and proposes a step from there: the learnt
    distribution may then lie in many places at once.

    A subclass names its `algorithm` and implements `_settings`, `_moments` and `_learn`, and
    `_squash` where it needs it.

    Attributes:
        algorithm: The name of the class in `stable_baselines3`.
    """

    packages = ("scikit-learn", "torch", "stable-baselines3")
    algorithm: ClassVar[str]

    options: SB3Options

    @abstractmethod
    def _settings(self, budget: int) -> dict[str, Any]:
        """Return the model's keywords beside those that all share, for so many queries."""

    @abstractmethod
    def _moments(self, start: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of the actions at the starts (n, d), each (n, d)."""

    def _squash(self, drawn: Array) -> Array:
        """Turn draws of the Gaussian, (n, d), into actions."""
        return drawn

    def _begin(self, budget: int) -> None:
        import stable_baselines3
        from stable_baselines3.common.logger import configure

        env: gym.Env[Any, Any] = gym.Env()  # nobody steps it; the model takes its spaces
        env.observation_space = env.action_space = gym.spaces.Box(-1.0, 1.0, (self.dimension,))
        settings = {
            "learning_rate": self.options.learning_rate,
            "policy_kwargs": {"net_arch": list(self.options.hidden)},
            **self._settings(budget),
        }
        model = getattr(stable_baselines3, self.algorithm)
        with self._seeded():
            self._model = model("MlpPolicy", env, device="cpu", **settings)
        self._model.set_logger(configure(None, []))

    def _act(self, n: int) -> PolicySteps:
        start = np.zeros((n, self.dimension))
        if self.options.starts == "uniform":
            start = self.rng.uniform(-1.0, 1.0, (n, self.dimension))
        try:
            with torch.no_grad(), one_thread():
                mean, deviation = self._moments(torch.as_tensor(start, dtype=torch.float32))
        except ValueError:  # torch refuses a normal distribution of NaN; the caller says why
            return PolicySteps(start, np.full(start.shape, np.nan))
        drawn = mean.numpy() + deviation.numpy() * self.rng.normal(size=(n, self.dimension))
        return PolicySteps(start, self._squash(drawn))

    def _update(self, **settings: Any) -> bool:
        try:
            with self._seeded():
                self._model.train(**settings)
        except ValueError:  # torch refuses a normal distribution of NaN
            return False
        return all(bool(weights.isfinite().all()) for weights in self._model.policy.parameters())

    @contextmanager
    def _seeded(self) -> Iterator[None]:
        from stable_baselines3.common.utils import set_random_seed

        seed = int(self.rng.integers(2**31))
        with generators_kept(), one_thread():
            set_random_seed(seed)
            yield

    def _arrays(self) -> Arrays:
        weights = self._model.policy.state_dict()
        return {f"policy.{name}": tensor.numpy() for name, tensor in weights.items()}

    def _restore(self, arrays: Arrays) -> None:
        self._begin(budget=1)
        weights = without_prefix(arrays, "policy.")
        self._model.policy.load_state_dict({k: torch.tensor(v) for k, v in weights.items()})
