"""Digits under attack: a handwritten digit is turned, slanted, thinned; Q is the true class's p."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.digits.base import ClassifierApplication
from sada_gym.envs.digits.classifier import ClassifierLike
from sada_gym.envs.digits.warps import Strokes, Warps, warp
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.foundations.arrays import Floats, Floats32, Indices, Integers
from sada_gym.parameters import Mu, Parameter, ParameterSpace

NAMES = ("rotation_deg", "scale", "shear", "shift_px", "contrast", "stroke")
"""The six parameters, in the order of mu's columns."""

LEAST = 2
"""Parameters that are chosen, at least."""


def ranges(width: int) -> dict[str, Parameter]:
    """Return the six parameters of images of this width; mu = 0 is neutral in each."""
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
    """A frozen classifier looks at a warped handwritten digit.

    ## Description
    The seed picks one of the real test images of scikit-learn's digits, 8 x 8 pixels. The adversary
    turns, scales, slants and moves the digit, and changes its contrast and the thickness of its
    stroke. The score Q is the classifier's softmax probability of the true class. An evaluation
    takes less than a tenth of a millisecond, so adversaries are developed here. With `image=` Q
    depends on mu alone, and each image has a landscape of its own.

    Seeds pick among the images that the classifier gets right at mu = 0. An image that it gets
    wrong unchanged would count as fooled whatever the adversary does.

    ## Action Space
    `Box(-1, 1, (6,), float32)`, mapped linearly; at mu = 0 the image is unchanged to the last bit:

    | index | parameter | at -1 | at +1 | unit |
    | --- | --- | --- | --- | --- |
    | 0 | `rotation_deg`, counterclockwise | -35 | 35 | deg |
    | 1 | `scale` about the image's centre | 0.75 | 1.25 | none |
    | 2 | `shear`: shift to the right for each pixel of height | -0.3 | 0.3 | none |
    | 3 | `shift_px` to the right | -1 | 1 | pixels |
    | 4 | `contrast` about middle grey | 0.5 | 1.5 | none |
    | 5 | `stroke`: thin or thick | -1 | 1 | none |

    `parameters=` picks two to six of them, by name, in the order given; the others stay neutral.
    Images of another width than 8 are shifted by up to an eighth of it.

    ## Observation Space
    `Box(-1, 1, (d + 2,), float32)`: last mu, last score, share of the steps left; zeros where there
    is none yet.

    ## Rewards
    A Python float, exactly `-info["score"]`: minus the softmax probability of the true class.

    ## Starting State
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s, whose hash
    picks the image.

    ## Episode End
    Terminated after `horizon` proposals (one by default), never truncated. `info` holds `score`,
    `fooled` (score <= 0.1, what a guess among ten classes gives), `seed`, `parameters`, `image`
    (its index), `label` (the true class) and `predicted` (the classifier's).

    ## Arguments
    - `digit=None`: the seed picks an image of this class; None: of any. Each has an id of its own,
      such as `SADA-Digits-3-v0`.
    - `image=None`: index among the test images: always this one, also if the classifier gets it
      wrong unchanged.
    - `parameters=("rotation_deg", "scale", "shear", "shift_px", "contrast", "stroke")`.
    - `agent="cnn"`: the shipped classifier, a safetensors file of its architecture, or any torch
      module from (B, 1, height, width) in [0, 1] to (B, K) logits.
    - `agent_id=None`: names an in-memory model where scores are stored; by default a hash of its
      weights.
    - `images=None`, `labels=None`: your own, (n, height, width) floats in [0, 1] with background 0,
      and (n,) classes from 0.
    - `tile=None`: images in one call of the classifier; by default 1 for a model of your own, and
      16 for the shipped architecture.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

    name = "SADA-Digits"
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
        chosen = _validate_parameters(parameters)
        super().__init__(image, digit, agent, agent_id, images, labels, tile)
        pictures = self.images.images[self.indices]
        every = ranges(pictures.shape[2])
        self.parameters = ParameterSpace(*(every[name] for name in chosen))
        self._neutral = {p.name: (p.low + p.high) / 2.0 for p in every.values()}
        self._strokes = Strokes(pictures)

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that a score depends on."""
        return {**super().settings, "parameters": list(self.parameters.names)}

    def _change(self, mu: Mu, positions: Indices) -> Floats32:
        values = {name: np.full(len(mu), neutral) for name, neutral in self._neutral.items()}
        values |= dict(zip(self.parameters.names, self.parameters.physical(mu).T, strict=True))
        return warp(self._strokes, positions, Warps(**values))

    def _score(self, probabilities: Floats, labels: Integers) -> Floats:
        score: Floats = probabilities[np.arange(len(labels)), labels]
        return score


def _validate_parameters(parameters: Any) -> tuple[str, ...]:
    if isinstance(parameters, str) or not isinstance(parameters, Sequence):
        raise UserTypeError(
            f"Expected parameters to be a list of names among {', '.join(NAMES)}, got "
            f"{parameters!r}."
        )
    check_known("parameters", parameters, NAMES)
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
