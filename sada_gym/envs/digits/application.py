"""Digits under attack: a handwritten digit is turned, slanted, thinned; Q is the true class's p."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.envs.digits.base import ClassifierApplication
from sada_gym.envs.digits.classifier import ClassifierLike
from sada_gym.envs.digits.warps import Strokes, Warps, warp
from sada_gym.errors import UserError, UserTypeError, refuse_unknown
from sada_gym.parameters import Mu, Parameter, ParameterSpace

NAMES = ("rotation_deg", "scale", "shear", "shift_px", "contrast", "stroke")
"""The six parameters, in the order of mu's columns."""

LEAST = 2
"""Parameters that are chosen, at least."""


def ranges(width: int) -> dict[str, Parameter]:
    """The six parameters of images of this width; mu = 0 is neutral in each."""
    shift = width / 8.0
    return {
        "rotation_deg": Parameter("rotation_deg", -35.0, 35.0, "deg"),
        "scale": Parameter("scale", 0.75, 1.25),
        "shear": Parameter("shear", -0.3, 0.3),
        "shift_px": Parameter("shift_px", -shift, shift, "px"),
        "contrast": Parameter("contrast", 0.5, 1.5),
        "stroke": Parameter("stroke", -1.0, 1.0),
    }


class DigitsApplication(ClassifierApplication):
    """A frozen classifier looks at a warped digit; Q is its probability of the true class.

    Args:
        digit: The seed picks a test image of this class; None: of any.
        image: Index among the test images: always this one, so that the seed changes nothing.
        parameters: Two to six of `NAMES`, in the order that mu has them; the others stay neutral.
        agent: See `ClassifierApplication`, as for the rest.
        agent_id: See there.
        images: See there.
        labels: See there.
        tile: See there.

    Raises:
        UserError: If the parameters are not as described, or see `ClassifierApplication`.
    """

    name: ClassVar[str] = "SADA-Digits"
    version: ClassVar[int] = 0
    fooling_threshold = 0.1
    sample_size = 250

    def __init__(
        self,
        digit: int | None = None,
        *,
        image: int | None = None,
        parameters: Sequence[str] = NAMES,
        agent: str | Path | ClassifierLike = "cnn",
        agent_id: str | None = None,
        images: npt.ArrayLike | None = None,
        labels: npt.ArrayLike | None = None,
        tile: int | None = None,
    ) -> None:
        chosen = _checked_parameters(parameters)
        super().__init__(
            image=image,
            digit=digit,
            agent=agent,
            agent_id=agent_id,
            images=images,
            labels=labels,
            tile=tile,
        )
        pictures = self.images.images[self.indices]
        every = ranges(pictures.shape[2])
        self.parameters = ParameterSpace(*(every[name] for name in chosen))
        self._neutral = {p.name: (p.low + p.high) / 2.0 for p in every.values()}
        self._strokes = Strokes(pictures)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {**super().settings, "parameters": list(self.parameters.names)}

    def _change(self, mu: Mu, positions: npt.NDArray[np.intp]) -> npt.NDArray[np.float32]:
        values = {name: np.full(len(mu), neutral) for name, neutral in self._neutral.items()}
        values |= dict(zip(self.parameters.names, self.parameters.physical(mu).T, strict=True))
        return warp(self._strokes, positions, Warps(**values))

    def _score(
        self, probabilities: npt.NDArray[np.float64], labels: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.float64]:
        score: npt.NDArray[np.float64] = probabilities[np.arange(len(labels)), labels]
        return score


def _checked_parameters(parameters: Any) -> tuple[str, ...]:
    if isinstance(parameters, str) or not isinstance(parameters, Sequence):
        raise UserTypeError(
            f"Expected parameters to be a list of names among {', '.join(NAMES)}, got "
            f"{parameters!r}."
        )
    refuse_unknown("parameters", parameters, NAMES)
    if len(set(parameters)) < len(parameters):
        raise UserError(
            f"Expected each parameter once, got {', '.join(parameters)}. Drop the doubles."
        )
    if len(parameters) < LEAST:
        raise UserError(
            f"Expected at least {LEAST} parameters among {', '.join(NAMES)}, got "
            f"{len(parameters)}: {', '.join(parameters) or 'none'}."
        )
    return tuple(parameters)
