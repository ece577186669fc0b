"""Reinforcement by SB3's PPO on the driving task."""

from __future__ import annotations

from collections.abc import Sequence

from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from sada_gym import agents
from sada_gym.agents.training import Report
from sada_gym.determinism import generators_kept
from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.agent.recipe import Reinforcement
from sada_gym.envs.driving.task import DrivingTaskVectorEnv
from sada_gym.sb3 import SB3VecEnv


class _Lessons(Report):
    """Keeps the driver as it is until values are known; says now and then how drives went.

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


def reinforce(settings: Reinforcement, *, seed: int) -> PPO:
    """Train a driver from nothing, or from a shipped driver's weights."""
    cars = SB3VecEnv(DrivingTaskVectorEnv(settings.course, num_envs=settings.cars))
    env = VecNormalize(VecMonitor(cars), norm_obs=False, gamma=settings.discount)
    env.seed(seed)
    model = new_model(
        seed,
        env,
        n_steps=settings.rollout,
        batch_size=settings.batch,
        n_epochs=settings.epochs,
        learning_rate=LinearSchedule(settings.rate, 0.0, 1.0),
        gamma=settings.discount,
        ent_coef=0.0,
        target_kl=0.03,
    )
    policy = model.policy
    driver = [
        *policy.features_extractor.parameters(),
        *policy.action_net.parameters(),
        policy.log_std,
    ]
    if settings.begins_as is not None:
        known = agents.load_driver(settings.begins_as).policy.state_dict()
        policy.load_state_dict(known | {"log_std": policy.log_std})
    with generators_kept():  # SB3 learns with the global ones
        model.set_random_seed(seed)
        model.learn(settings.steps, callback=_Lessons(driver, settings.value_steps))
    return model
