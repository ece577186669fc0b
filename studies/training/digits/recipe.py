"""How the shipped classifier is trained."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClassifierRecipe:
    """How a classifier is trained.

    Attributes:
        epochs: Passes over the training images.
        batch: Images a step.
        rate: Highest learning rate of the one-cycle schedule (AdamW).
        weight_decay: The weight decay of AdamW.
        rotation_deg: Training images are turned by up to this much.
        scale: Training images are enlarged or shrunk by up to this share.
        shift_px: Training images are moved to the side by up to this much.
    """

    epochs: int = 100
    batch: int = 64
    rate: float = 4e-3
    weight_decay: float = 1e-2
    rotation_deg: float = 8.0
    scale: float = 0.06
    shift_px: float = 0.4


RECIPES = {"cnn": ClassifierRecipe()}
