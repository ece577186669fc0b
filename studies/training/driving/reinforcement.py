"""Reinforcement by SB3's PPO on the driving task."""

from __future__ import annotations

from collections.abc import Sequence

from stable_baselines3 import PPO
from torch import nn

from sada_gym import agents
from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.episodes import DriveDistribution
from sada_gym.envs.driving.task import DrivingTaskVectorEnv
from studies.training.common import Reinforcement, Report, learn, new_learner


class _ValueFirst(Report):
    """Keeps the driver as it is until values are known, and prints how drives ended.

    Args:
        kept: The driver's parameters.
        value_steps: How long they are kept.
    """

    def __init__(self, kept: Sequence[nn.Parameter], value_steps: int) -> None:
        super().__init__("arrived")
        self._kept, self._value_steps = kept, value_steps

    def _on_rollout_start(self) -> None:
        for parameter in self._kept:
            parameter.requires_grad_(self.num_timesteps >= self._value_steps)


def reinforce(settings: Reinforcement[DriveDistribution], *, seed: int) -> PPO:
    """Train a driver from nothing, or from a shipped driver's weights."""
    tasks = DrivingTaskVectorEnv(settings.distribution, num_envs=settings.lockstep)
    model = new_learner(new_model, tasks, settings, seed=seed)
    policy = model.policy
    driver = [
        *policy.features_extractor.parameters(),
        *policy.action_net.parameters(),
        policy.log_std,
    ]
    if settings.initial_agent is not None:
        known = agents.load(settings.initial_agent, "SADA-Driving").policy.state_dict()
        policy.load_state_dict(known | {"log_std": policy.log_std})
    return learn(model, settings, seed=seed, report=_ValueFirst(driver, settings.value_steps))
