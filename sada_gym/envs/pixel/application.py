"""The pixel attack: mu is noise on an image; Q is by how much the true class leads the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.checks import is_number
from sada_gym.envs.digits.base import ClassifierApplication
from sada_gym.envs.digits.classifier import ClassifierLike
from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.arrays import Floats, Floats32, Indices, Integers
from sada_gym.parameters import Mu, Parameter, ParameterSpace

RADIUS = 0.15
"""Greatest change of a pixel by default."""


class PixelApplication(ClassifierApplication):
    """A frozen classifier looks at an image with noise on it.

    ## Description
    The pixel attack of the SADA paper's supplement: mu is noise on the image, one number a pixel.
    The score is Q = max(p_y - max over j != y of p_j, 0), with p the classifier's softmax
    probabilities and y the true class. The classifier is fooled where Q = 0: where another class is
    at least as likely as the true one.

    By default one image is attacked, the first test image that the classifier gets right: noise is
    made for one image. With `digit=` the seed picks an image of this class, so that mu is one noise
    for many images.

    ## Action Space
    `Box(-1, 1, (64,), float32)`: `row0_column0`, `row0_column1`, ..., row by row, the noise in
    units of `radius`. A pixel x becomes x + mu min(radius, 1 - x) where mu is positive, and
    x + mu min(radius, x) where it is negative. So the image stays in [0, 1], no pixel changes by
    more than `radius`, every such image can be reached, and mu = 0 is the unchanged image. A black
    pixel cannot become darker: negative mu leave it as it is.

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`: last mu, last score, share of the steps left; zeros where there
    is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`.

    ## Starting State
    No proposal yet. The seed changes nothing, unless `digit=` is given: then a hash of the seed
    picks one of the images that the classifier gets right unchanged.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0), `seed`, `parameters` (radius times mu: the noise that was asked for),
    `image` (its index), `label` (the true class) and `predicted` (the classifier's).

    ## Arguments
    - `image=None`: index among the test images, also of one that the classifier gets wrong
      unchanged; by default the first that it gets right.
    - `digit=None`: the seed picks an image of this class instead.
    - `radius=0.15`: the greatest change of a pixel, in (0, 1].
    - `agent="cnn"`: the shipped classifier, a safetensors file of its architecture, or any torch
      module from (B, 1, height, width) in [0, 1] to (B, K) logits.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `images=None`, `labels=None`: your own, (n, height, width) floats in [0, 1], and (n,) classes
      from 0. Then d is height times width.
    - `tile=None`: images in one call of the classifier; by default 1 for a model of your own, and
      16 for the shipped architecture.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Pixel"
    fooling_threshold = 0.0
    sample_size = 100

    def __init__(
        self,
        image: int | None = None,
        *,
        digit: int | None = None,
        radius: float = RADIUS,
        agent: str | Path | ClassifierLike = "cnn",
        agent_id: str | None = None,
        images: npt.ArrayLike | None = None,
        labels: npt.ArrayLike | None = None,
        tile: int | None = None,
    ) -> None:
        self.radius = _validate_radius(radius)
        super().__init__(image, digit, agent, agent_id, images, labels, tile)
        if image is None and digit is None:
            self.indices = self.indices[:1]
            self.image = int(self.indices[0])
        height, width = self.images.images.shape[1:]
        self.parameters = ParameterSpace(
            *(
                Parameter(f"row{row}_column{column}", -self.radius, self.radius)
                for row in range(height)
                for column in range(width)
            )
        )

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {**super().settings, "radius": self.radius}

    def attacked(self, mu: npt.ArrayLike, images: Floats32) -> Floats32:
        """Put the noise of mu, (n, d), on images (n, height, width): the attacked images."""
        return self._attacked(self.parameters.validate(mu), images)

    def _attacked(self, mu: Mu, images: Floats32) -> Floats32:
        clean = images.astype(np.float64)
        share = mu.astype(np.float64).reshape(clean.shape)
        room = np.where(share > 0.0, 1.0 - clean, clean)
        attacked = clean + share * np.minimum(self.radius, room)
        return np.clip(attacked, 0.0, 1.0).astype(np.float32)

    def _change(self, mu: Mu, positions: Indices) -> Floats32:
        return self._attacked(mu, self.images.images[self.indices[positions]])

    def _score(self, probabilities: Floats, labels: Integers) -> Floats:
        rows = np.arange(len(labels))
        true = probabilities[rows, labels]
        others = probabilities.copy()
        others[rows, labels] = 0.0
        score: Floats = np.maximum(true - others.max(axis=1), 0.0)
        return score


def _validate_radius(radius: Any) -> float:
    if not is_number(radius):
        raise UserTypeError(f"Expected radius to be a number in (0, 1], got {radius!r}.")
    if not 0.0 < radius <= 1.0:
        raise UserError(
            f"Expected radius within (0, 1], got {radius}. Pixels are within [0, 1]; 0.1 changes "
            "each by at most a tenth of that."
        )
    return float(radius)
