"""How the shipped robots are trained."""

from __future__ import annotations

from dataclasses import replace

from sada_gym.envs.robot.start_distribution import StartDistribution
from studies.training.common import Recipe, Reinforcement

_PPO = Reinforcement(
    distribution=StartDistribution(),
    lockstep=64,
    steps=1_500_000,
    rollout=64,
    batch=1_024,
    epochs=6,
    rate=5e-4,
    discount=0.98,
)

RECIPES: dict[str, Recipe[StartDistribution]] = {
    "ppo": _PPO,
    "ppo-randomised": replace(_PPO, distribution=StartDistribution(spread=0.25)),
}
