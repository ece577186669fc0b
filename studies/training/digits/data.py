"""The classifier learns from the training digits, mildly changed anew in each epoch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from sada_gym.envs.digits.images import TEST_EVERY, LabelledImages, all_digits, turns
from sada_gym.envs.digits.warps import Strokes, Warps, warp
from studies.training.digits.recipe import ClassifierRecipe


def training_images(*, validation: bool = False) -> tuple[LabelledImages, LabelledImages]:
    """Return the images to train on and those to choose hyper-parameters by; none is a test image.

    Args:
        validation: Whether to hold back a third of the training images, the 3rd, 7th, 11th ... of
            each digit. Without it the second part is that third, too, but the first part has it.
    """
    place = turns() % TEST_EVERY
    is_validation = place == TEST_EVERY - 2
    train = (place != TEST_EVERY - 1) & ~(is_validation & validation)
    digits = all_digits()
    return digits[np.flatnonzero(train)], digits[np.flatnonzero(is_validation)]


def batches(
    data: LabelledImages, recipe: ClassifierRecipe, rng: np.random.Generator
) -> Iterator[tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]]:
    """Yield an epoch of shuffled, changed images (b, 8, 8) and their labels (b,)."""
    strokes = Strokes(data.images)
    order = rng.permutation(len(data))
    for start in range(0, len(order), recipe.batch):
        rows = order[start : start + recipe.batch]
        yield warp(strokes, rows, _mild(recipe, len(rows), rng)), data.labels[rows]


def _mild(recipe: ClassifierRecipe, count: int, rng: np.random.Generator) -> Warps:
    def within(width: float) -> npt.NDArray[np.float64]:
        return rng.uniform(-width, width, count)

    return Warps(
        rotation_deg=within(recipe.rotation_deg),
        scale=1.0 + within(recipe.scale),
        shear=np.zeros(count),
        shift_px=within(recipe.shift_px),
        contrast=np.ones(count),
        stroke=np.zeros(count),
    )
