"""SADA-Digits as Gymnasium environments: a classifier attacked by warps of a handwritten digit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy.typing as npt

from sada_gym.envs.adversary import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.digits.application import NAMES, DigitsApplication
from sada_gym.envs.digits.classifier import ClassifierLike


class DigitsEnv(AdversaryEnv):
    """A frozen classifier looks at a warped handwritten digit.

    ## Description
    The seed picks one of the real test images of scikit-learn's digits, 8 x 8 pixels. The adversary
    turns, scales, slants and moves the digit, and changes its contrast and the thickness of its
    stroke. The score Q is the classifier's softmax probability of the true class. An evaluation
    takes a tenth of a millisecond, so adversaries are developed here. With `image=` the landscape
    is deterministic: one of a real image each.

    Seeds pick among the images that the classifier gets right at mu = 0. An image that it gets
    wrong unchanged would count as fooled whatever the adversary does.

    ## Action Space
    `Box(-1, 1, (6,), float32)`, linear in; at mu = 0 the image is unchanged, to the last bit:

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
    No proposal yet. The first evaluation after `reset(seed=s)` has the seed s. Of n images, seed s
    picks the one at s modulo n.

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
    - `agent_id=None`: names an in-memory model in evaluation stores; by default a hash of its
      weights.
    - `images=None`, `labels=None`: your own, (n, height, width) floats in [0, 1] with background 0,
      and (n,) classes from 0.
    - `tile=None`: images in one call of the classifier; by default 1 for a model of your own, and
      16 for the shipped architecture.
    - `horizon=1`, `render_mode=None`: see `AdversaryEnv`.

    ## Version History
    - v0: initial version.
    """

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
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DigitsApplication(
            digit,
            image=image,
            parameters=parameters,
            agent=agent,
            agent_id=agent_id,
            images=images,
            labels=labels,
            tile=tile,
        )
        super().__init__(application, horizon=horizon, render_mode=render_mode)


class DigitsVectorEnv(AdversaryVectorEnv):
    """`DigitsEnv` in a batch: the classifier sees tiles of images."""

    def __init__(
        self,
        digit: int | None = None,
        *,
        num_envs: int = 1,
        image: int | None = None,
        parameters: Sequence[str] = NAMES,
        agent: str | Path | ClassifierLike = "cnn",
        agent_id: str | None = None,
        images: npt.ArrayLike | None = None,
        labels: npt.ArrayLike | None = None,
        tile: int | None = None,
        horizon: int = 1,
        render_mode: str | None = None,
    ) -> None:
        application = DigitsApplication(
            digit,
            image=image,
            parameters=parameters,
            agent=agent,
            agent_id=agent_id,
            images=images,
            labels=labels,
            tile=tile,
        )
        super().__init__(application, num_envs=num_envs, horizon=horizon, render_mode=render_mode)
