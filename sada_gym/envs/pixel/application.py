"""The pixel attack: mu is noise on an image; Q is by how much the true class leads the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.envs.digits.base import ClassifierApplication
from sada_gym.envs.digits.classifier import ClassifierLike
from sada_gym.errors import UserError, UserTypeError
from sada_gym.parameters import Mu, Parameter, ParameterSpace

RADIUS = 0.15
"""Greatest change of a pixel by default."""


class PixelApplication(ClassifierApplication):
    """A frozen classifier looks at an image with noise on it.

    Q = max(p_y - max over j != y of p_j, 0), with p the softmax probabilities and y the true class
    (the paper's supplement, "Pixel Adversarial Attack on Image Classifiers"). The classifier is
    fooled where Q = 0: where another class is at least as likely.

    A pixel x becomes x + mu min(radius, 1 - x) where mu is positive and x + mu min(radius, x) where
    it is negative: mu in [-1, 1]^d reaches exactly the images in [0, 1]^d within `radius` of x.

    Args:
        image: Index among the test images. By default the first that the classifier gets right.
        digit: The seed picks an image of this class instead: one noise for many images.
        radius: Greatest change of a pixel, in (0, 1].
        agent: See `ClassifierApplication`, as for the rest.
        agent_id: See there.
        images: See there.
        labels: See there.
        tile: See there.

    Raises:
        UserError: If the radius is not as described, or see `ClassifierApplication`.
    """

    name: ClassVar[str] = "SADA-Pixel"
    version: ClassVar[int] = 0
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
        self.radius = _checked_radius(radius)
        super().__init__(
            image=image,
            digit=digit,
            agent=agent,
            agent_id=agent_id,
            images=images,
            labels=labels,
            tile=tile,
        )
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

    def attacked(
        self, mu: npt.ArrayLike, images: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Put the noise of mu, (n, d), on images (n, height, width): the attacked images."""
        return self._attacked(self.parameters.validate(mu), images)

    def _attacked(self, mu: Mu, images: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        clean = images.astype(np.float64)
        share = mu.astype(np.float64).reshape(clean.shape)
        room = np.where(share > 0.0, 1.0 - clean, clean)
        attacked = clean + share * np.minimum(self.radius, room)
        return np.clip(attacked, 0.0, 1.0).astype(np.float32)

    def _change(self, mu: Mu, positions: npt.NDArray[np.intp]) -> npt.NDArray[np.float32]:
        return self._attacked(mu, self.images.images[self.indices[positions]])

    def _score(
        self, probabilities: npt.NDArray[np.float64], labels: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.float64]:
        rows = np.arange(len(labels))
        true = probabilities[rows, labels]
        others = probabilities.copy()
        others[rows, labels] = 0.0
        score: npt.NDArray[np.float64] = np.maximum(true - others.max(axis=1), 0.0)
        return score


def _checked_radius(radius: Any) -> float:
    if isinstance(radius, bool) or not isinstance(radius, int | float | np.number):
        raise UserTypeError(f"Expected radius to be a number in (0, 1], got {radius!r}.")
    if not 0.0 < radius <= 1.0:
        raise UserError(
            f"Expected radius within (0, 1], got {radius}. Pixels are within [0, 1]; 0.1 changes "
            "each by at most a tenth of that."
        )
    return float(radius)
