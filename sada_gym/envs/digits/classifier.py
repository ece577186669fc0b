"""The classifier as the applications call it: in tiles, and with what it gives checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from sada_gym.agents.contract import Indices
from sada_gym.agents.identity import fingerprint
from sada_gym.agents.tile import Batch, tiled
from sada_gym.envs.checks import check_evaluation_mode, check_tile
from sada_gym.errors import UserError, UserTypeError, explained
from sada_gym.foundations.arrays import Floats, Floats32

if TYPE_CHECKING:
    from torch import Tensor

CLASSIFIER_TILE = 16
"""Images in one call of a classifier of the shipped architecture; a part of the scores."""

_ENOUGH_IMAGES = 8
_SUMS_TO_ONE = 1e-3

ClassifierLike = Callable[["Tensor"], "Tensor"]
"""Takes (B, 1, height, width) float32 in [0, 1], gives (B, K) logits: a torch module, mostly."""

_CONVENTION = (
    "The classifier must take (B, 1, height, width) and return (B, K) logits, one for each of K "
    "classes, before any softmax."
)


class ClassifierAgent:
    """A classifier that looks at images in tiles of one fixed size, filled up with black images.

    Args:
        network: Takes (B, 1, height, width), gives (B, K) logits.
        tile: Images in one call; by default 16 for the shipped architecture and 1 for others.

    Raises:
        UserError: If the network cannot be called or is in training mode, or the tile is not an
            int from 1 to `MAX_TILE`.
    """

    def __init__(self, network: ClassifierLike, tile: int | None = None) -> None:
        if not callable(network):
            raise UserTypeError(
                f"Expected agent to be a shipped classifier's name, a file of weights or a torch "
                f"module, got {type(network).__name__}."
            )
        from sada_gym.envs.digits.agent.network import DigitNetwork

        check_evaluation_mode(network, "classifier")
        self.network = network
        default = CLASSIFIER_TILE if isinstance(network, DigitNetwork) else 1
        self.tile = default if tile is None else check_tile(tile, "classifier")
        self._classes: int | None = None

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the network's weights, None where they are unknown."""
        return fingerprint(self.network)

    def start(self, count: int) -> None:
        """Begin with `count` new images; the classifier remembers no others."""

    def act(self, episodes: Floats32, which: Indices | None = None) -> Floats:
        """Return the softmax over the classes, (n, K).

        Args:
            episodes: Images (m, height, width).
            which: (n,) indices of those to look at; by default all.

        Raises:
            UserError: If the network cannot take such images, or its output is not (B, K) finite
                numbers with K of at least 2.
        """
        chosen = np.asarray(episodes if which is None else episodes[which], np.float32)
        parts = tiled(self._probabilities, {"image": chosen[:, None]}, self.tile, blank=True)
        classes = {part.shape[1] for part in parts} | ({self._classes} if self._classes else set())
        if len(classes) > 1:
            raise UserError(f"Expected the same K for every batch, got others. {_CONVENTION}")
        (self._classes,) = classes
        return np.concatenate(parts)

    def check_logits(self, images: Floats32) -> None:
        """Raise `UserError` if all the answers to several images, (n, height, width), sum to 1.

        Such a classifier ends in a softmax; after another one its scores would be wrong.
        """
        if len(images) < _ENOUGH_IMAGES:
            return
        batch = {"image": images[:_ENOUGH_IMAGES, None]}
        logits = np.concatenate(tiled(self._logits, batch, self.tile, blank=True))
        if (logits >= 0).all() and np.abs(logits.sum(axis=1) - 1).max() < _SUMS_TO_ONE:
            raise UserError(
                "Expected logits from the classifier, got probabilities, which sum to 1. Pass the "
                f"network without its softmax, or its logarithm. {_CONVENTION}"
            )

    def _probabilities(self, batch: Batch) -> Floats:
        import torch

        probabilities: Floats = torch.from_numpy(self._logits(batch)).softmax(dim=1).numpy()
        return probabilities

    def _logits(self, batch: Batch) -> Floats:
        import torch

        with torch.inference_mode():
            images = torch.from_numpy(batch["image"])
            expected = f"Expected a classifier that takes {tuple(images.shape)} float32 on the CPU"
            with explained(expected, _CONVENTION):
                logits = _validate_logits(self.network(images), self.tile)
                numbers: Floats = logits.double().cpu().numpy()
        return numbers


def _validate_logits(logits: Any, count: int) -> Tensor:
    import torch

    if not isinstance(logits, torch.Tensor):
        flaw = f"a tensor from the classifier, got {type(logits).__name__}"
    elif logits.ndim != 2 or len(logits) != count or logits.shape[1] < 2:
        flaw = (
            f"an output of shape ({count}, K) from the classifier, K of at least 2, got "
            f"{tuple(logits.shape)}"
        )
    elif not logits.is_floating_point():
        flaw = f"an output of floats from the classifier, got {logits.dtype}"
    elif not torch.isfinite(logits).all():
        flaw = "finite numbers from the classifier, got NaN or infinity"
    else:
        return logits
    raise UserError(f"Expected {flaw}. {_CONVENTION}")
