"""Reinforcement by SB3's PPO on the driving task."""

from __future__ import annotations

from stable_baselines3 import PPO

from sada_gym import agents
from sada_gym.envs.driving.agent.network import new_model
from sada_gym.envs.driving.episodes import DriveDistribution
from sada_gym.envs.driving.task import DrivingTaskVectorEnv
from studies.training.common import Reinforcement, ValueFirst, learn, new_learner


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
    report = ValueFirst("arrived", driver, settings.value_steps)
    return learn(model, settings, seed=seed, report=report)
