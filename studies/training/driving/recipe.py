"""How the shipped drivers are trained."""

from __future__ import annotations

from dataclasses import replace

from sada_gym.envs.driving.episodes import DriveDistribution
from studies.training.common import Imitation, Recipe, Reinforcement

NEAR_THE_LANE = DriveDistribution(lateral_m=0.8, turned_deg=8.0, speed_m_s=8.0)
"""Default camera, the four training weathers; cars start from anywhere near a lane's middle."""

OTHER_CAMERAS = replace(NEAR_THE_LANE, height_m=(1.15, 1.65), pitch_deg=(-17.5, -12.5))
"""The same with another camera each drive: half of the benchmark's range of either parameter."""

_CIL = Imitation(
    distribution=NEAR_THE_LANE,
    lockstep=64,
    rounds=8,
    steps=8_000,
    epochs=3,
    last_epochs=8,
    batch=128,
    rate=5e-4,
    light_jitter=0.25,
)

RECIPES: dict[str, Recipe[DriveDistribution]] = {
    "cil": _CIL,
    "cil-augmented": replace(_CIL, distribution=OTHER_CAMERAS, light_jitter=0.4),
    "ppo": Reinforcement(
        distribution=NEAR_THE_LANE,
        lockstep=32,
        steps=200_000,
        rollout=128,
        batch=512,
        epochs=4,
        rate=1e-4,
        discount=0.97,
        initial_agent="cil",
        value_steps=40_000,
    ),
}
