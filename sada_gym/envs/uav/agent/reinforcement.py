"""Reinforcement by SB3's PPO on the racing task, from scratch: a pilot without a camera."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.type_aliases import GymEnv
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from sada_gym.agents.training import Report
from sada_gym.determinism import generators_kept
from sada_gym.envs.uav.agent.recipe import Reinforcement
from sada_gym.envs.uav.task import RacingTaskEnv, RacingTaskVectorEnv
from sada_gym.sb3 import SB3VecEnv

_LOG_NOISE = -1.0
"""Of the actions that it begins with: 0.37; with SB3's own, 1, few drones reach a gate."""


def new_model(seed: int, env: GymEnv | None = None, **options: Any) -> PPO:
    """Make an untrained pilot: two layers of 64 units for the actions, and for the value.

    Args:
        seed: Fixes the weights.
        env: What it will be trained on; by default one task.
        **options: Others of PPO.
    """
    with generators_kept():
        return PPO(
            "MultiInputPolicy",
            env or RacingTaskEnv(),
            policy_kwargs={
                "net_arch": {"pi": [64, 64], "vf": [64, 64]},
                "log_std_init": _LOG_NOISE,
            },
            seed=seed,
            device="cpu",
            **options,
        )


def reinforce(settings: Reinforcement, *, seed: int) -> PPO:
    """Train a pilot from nothing."""
    drones = SB3VecEnv(RacingTaskVectorEnv(settings.course, num_envs=settings.drones))
    env = VecNormalize(VecMonitor(drones), norm_obs=False, gamma=settings.discount)
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
    with generators_kept():  # SB3 learns with the global ones
        model.set_random_seed(seed)
        model.learn(settings.steps, callback=Report("finished"))
    env.close()
    return model
