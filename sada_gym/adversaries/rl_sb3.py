"""`ppo`, `sac` and `td3`: Stable-Baselines3's models learn from our rollouts, by our seeds."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor

from sada_gym.adversaries.fitted import Arrays, without_prefix
from sada_gym.adversaries.options import option
from sada_gym.adversaries.rl import PolicySteps, RLAdversary, RLOptions
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.determinism import generators_kept, one_thread


@dataclass(frozen=True)
class SB3Options(RLOptions):
    """The options of the adversaries of Stable-Baselines3, in addition to those of `RLOptions`.

    Attributes:
        starts: Where episodes start: in the `centre` of the box, or `uniform` in it.
        hidden: The widths of the hidden layers of each network.
    """

    starts: str = option("uniform", choices=("centre", "uniform"))
    hidden: tuple[int, ...] = option((64, 64), 1, 1_024)


class SB3Adversary(RLAdversary):
    """An adversary whose policy and update rule are those of Stable-Baselines3.

    This class draws the actions, queries the oracle and gives rewards; then the model's own `train`
    improves the policy. So the oracle never runs while Stable-Baselines3 uses the global
    generators. The policy observes where an episode starts and proposes a step from there. So with
    uniform starts, the learnt distribution can cover many separate places.

    A subclass names its `algorithm`, the class in `stable_baselines3`, and implements `_settings`,
    `_moments` and `learn`. It overrides `_squash` if it needs to.
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

    def _squash(self, drawn: Floats) -> Floats:
        """Turn draws of the Gaussian, (n, d), into actions."""
        return drawn

    def begin(self, budget: int) -> None:
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

    def act(self, n: int) -> PolicySteps:
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

    def arrays(self) -> Arrays:
        weights = self._model.policy.state_dict()
        return {f"policy.{name}": tensor.numpy() for name, tensor in weights.items()}

    def restore(self, arrays: Arrays) -> None:
        self.begin(budget=1)
        weights = without_prefix(arrays, "policy.")
        self._model.policy.load_state_dict({k: torch.tensor(v) for k, v in weights.items()})


@dataclass(frozen=True)
class PPOOptions(SB3Options):
    """The options of `ppo`, in addition to those of `SB3Options`.

    Attributes:
        epochs: The number of steps of Adam on each rollout.
        log_deviation: The logarithm of the standard deviation that the Gaussian starts with.
        entropy: The weight of the policy's entropy in the loss.
    """

    rollout: int = option(50, 2, 100_000)
    epochs: int = option(30, 1, 1_000)
    log_deviation: float = option(-1.0, -10, 2)
    entropy: float = option(0.0, 0, 100)


class PPO(SB3Adversary):
    """A Gaussian policy that PPO improves after each rollout, on the latest rollout only.

    This is proximal policy optimisation (Schulman et al. 2017) by Stable-Baselines3. It uses only
    the order of the uniform queries' scores, because they are not actions of the policy. See
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

    def learn(self, steps: PolicySteps, rewards: Floats) -> bool:
        rows = steps.start, steps.action
        tensors = (torch.as_tensor(array, dtype=torch.float32) for array in rows)
        with torch.no_grad(), one_thread():
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


@dataclass(frozen=True)
class OffPolicyOptions(SB3Options):
    """The options of `sac` and `td3`, in addition to those of `SB3Options`.

    For each query there are `updates` steps of Adam, each on `batch` queries.
    """

    updates: float = option(0.5, 0, 100, inside=True)
    batch: int = option(128, 1, 100_000)


class OffPolicyAdversary(SB3Adversary):
    """An adversary of Stable-Baselines3 that learns from all queries, the uniform ones included."""

    options: OffPolicyOptions

    def _settings(self, budget: int) -> dict[str, Any]:
        return {"buffer_size": budget}

    def _learn_uniform(self, queries: Evaluations, rewards: Floats) -> None:
        mu = queries.mu.astype(np.float64)
        start = np.zeros_like(mu)
        if self.options.starts == "uniform":  # an action reaches no further than 1
            start = self.rng.uniform(np.maximum(mu - 1.0, -1.0), np.minimum(mu + 1.0, 1.0))
        self._remember(PolicySteps(start, mu - start), rewards)

    def learn(self, steps: PolicySteps, rewards: Floats) -> bool:
        self._remember(steps, rewards)
        updates = max(1, round(self.options.updates * self.options.rollout))
        return self._update(gradient_steps=updates, batch_size=self.options.batch)

    def _remember(self, steps: PolicySteps, rewards: Floats) -> None:
        over = np.ones(1)
        for start, action, reward in zip(steps.start, steps.action, rewards, strict=True):
            self._model.replay_buffer.add(start, start, action, reward, over, [{}])


@dataclass(frozen=True)
class SACOptions(OffPolicyOptions):
    """The options of `sac`, in addition to those of `OffPolicyOptions`.

    `entropy` is the temperature: the reward for each nat of the policy's entropy.
    """

    dissimilarity: float = option(0.5, 0, 100)
    entropy: float = option(0.05, 0, 100)


class SAC(OffPolicyAdversary):
    """A Gaussian policy, squashed into the box, that a critic of all queries so far improves.

    This is the soft actor-critic (Haarnoja et al. 2018) by Stable-Baselines3, with a fixed
    temperature. At the optimum an action's density is proportional to exp(reward / temperature), as
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

    def _squash(self, drawn: Floats) -> Floats:
        return np.tanh(drawn)


@dataclass(frozen=True)
class TD3Options(OffPolicyOptions):
    """The options of `td3`, in addition to those of `OffPolicyOptions`.

    `noise` is the standard deviation of the noise on every action, in training and in samples. This
    noise is the only randomness of the policy.
    """

    updates: float = option(1.0, 0, 100, inside=True)
    noise: float = option(0.05, 0, 10, inside=True)


class TD3(OffPolicyAdversary):
    """A deterministic policy that a critic of all queries improves, with Gaussian noise around it.

    This is twin delayed deterministic policy gradients (Fujimoto, van Hoof & Meger 2018) by
    Stable-Baselines3. A deterministic policy is not a distribution, so samples are its actions with
    its exploration noise added. See `TD3Options`.
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
