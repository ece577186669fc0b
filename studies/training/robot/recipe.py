"""How the shipped robots are trained."""

from __future__ import annotations

from dataclasses import replace

from sada_gym.envs.robot.start import TripDistribution
from studies.training.common import Recipe, Reinforcement

_PPO = Reinforcement(
    distribution=TripDistribution(),
    lockstep=64,
    steps=1_500_000,
    rollout=64,
    batch=1_024,
    epochs=6,
    rate=5e-4,
    discount=0.98,
)

RECIPES: dict[str, Recipe[TripDistribution]] = {
    "ppo": _PPO,
    "ppo-randomised": replace(_PPO, distribution=TripDistribution(spread=0.25)),
}
