"""Reinforcement by SB3's PPO on the racing task, from scratch: a pilot without a camera."""

from __future__ import annotations

from stable_baselines3 import PPO

from sada_gym.envs.uav.agent.network import new_model
from sada_gym.envs.uav.episodes import RaceDistribution
from sada_gym.envs.uav.task import RacingTaskVectorEnv
from studies.training.common import Reinforcement, Report, learn, new_learner


def reinforce(settings: Reinforcement[RaceDistribution], *, seed: int) -> PPO:
    """Train a pilot from nothing."""
    tasks = RacingTaskVectorEnv(settings.distribution, num_envs=settings.lockstep)
    model = new_learner(new_model, tasks, settings, seed=seed)
    return learn(model, settings, seed=seed, report=Report("finished"))
