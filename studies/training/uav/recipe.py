"""How the shipped pilots are trained."""

from __future__ import annotations

from dataclasses import replace

from sada_gym.envs.uav.episodes import RaceDistribution
from sada_gym.envs.uav.world.guidance import SPEED_M_S
from studies.training.common import Imitation, Recipe, Reinforcement

MILD = RaceDistribution(spread=0.25, shift_m=0.5, turned_deg=15.0, speed_m_s=SPEED_M_S)
"""Tracks of all numbers of anchors, little displaced; races begin between any two gates."""
WIDE = replace(MILD, spread=0.5)
"""Tracks that are displaced twice as far: trained on less, `ppo` misses gates of mild tracks."""

RECIPES: dict[str, Recipe[RaceDistribution]] = {
    "waypoint-pid": Imitation(
        distribution=MILD,
        lockstep=48,
        rounds=6,
        steps=9_600,
        epochs=2,
        last_epochs=8,
        batch=128,
        rate=1.5e-3,
        light_jitter=0.15,
    ),
    "ppo": Reinforcement(
        distribution=WIDE,
        lockstep=32,
        steps=2_400_000,
        rollout=128,
        batch=512,
        epochs=8,
        rate=5e-4,
        discount=0.97,
    ),
}
