"""How the shipped driver of MetaDrive is trained."""

from __future__ import annotations

from sada_gym.envs.metadrive.start import DriveDistribution
from studies.training.common import Imitation, Recipe, Reinforcement

IMITATION = Imitation(
    distribution=DriveDistribution(spread=1.0, empty=0.5),
    lockstep=1,
    rounds=8,
    steps=7_500,
    epochs=4,
    last_epochs=20,
    batch=256,
    rate=1e-3,
    light_jitter=0.0,
)
"""What comes before PPO: from scratch, PPO arrived in a quarter of its drives after an hour."""

RECIPES: dict[str, Recipe[DriveDistribution]] = {
    "metadrive-ppo": Reinforcement(
        distribution=DriveDistribution(spread=1.0, empty=0.5),
        lockstep=1,
        steps=200_000,
        rollout=2_048,
        batch=256,
        epochs=4,
        rate=1e-4,
        discount=0.99,
        value_steps=20_480,
    )
}
