"""How the shipped detectors are trained."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectorRecipe:
    """How a detector is trained.

    Attributes:
        survey_share: Share of training views from everywhere; the rest follow the prior.
        per_class: Frames of each class.
        empty_share: Frames without an object, as a share of those with one.
        epochs: Passes over the set.
        batch: Frames a step.
        rate: Highest learning rate of the one-cycle schedule (AdamW).
        image_size: Pixels a side.
    """

    survey_share: float
    per_class: int = 1_200
    empty_share: float = 0.05
    epochs: int = 12
    batch: int = 48
    rate: float = 4e-3
    image_size: int = 128


RECIPES = {
    "photographer": DetectorRecipe(survey_share=0.0),
    "surveyor": DetectorRecipe(survey_share=0.1),
}
