"""How the shipped driver of MetaDrive is trained."""

from __future__ import annotations

from sada_gym.envs.metadrive.start import DriveDistribution
from studies.training.common import Recipe, Reinforcement

RECIPES: dict[str, Recipe[DriveDistribution]] = {
    "metadrive-ppo": Reinforcement(
        distribution=DriveDistribution(spread=0.5, empty=0.5),
        lockstep=1,
        steps=420_000,
        rollout=2_048,
        batch=256,
        epochs=6,
        rate=3e-4,
        discount=0.99,
    )
}
