"""The detector as the application calls it: in tiles, and with what it holds and gives checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Indices
from sada_gym.agents.identity import fingerprint
from sada_gym.agents.tile import Batch, tiled
from sada_gym.application import Frame
from sada_gym.envs.checks import checked_tile, refuse_training_mode
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from torch import Tensor

DETECTOR_TILE = 14
"""Images in one call of a detector of the shipped architecture; a part of the benchmark's scores.
Larger tiles make a batch cheaper and a single evaluation dearer."""

TOP_DETECTIONS = 20
"""The most detections of an image that count, best first."""

DetectorLike = Callable[[list["Tensor"]], Sequence[Mapping[str, "Tensor"]]]
"""Anything with torchvision's calling convention: see `Detector` in `agent/network.py`."""

Detections = dict[str, npt.NDArray[Any]]
"""One image's `boxes` (N, 4), `labels` (N,) and `scores` (N,), best first."""


class DetectorAgent:
    """A detector that looks at images in tiles of one fixed size, filled up with black images.

    Args:
        network: Keeps torchvision's calling convention.
        tile: Images in one call; by default 14 for the shipped architecture and 1 for others.

    Raises:
        UserError: If the network is in training mode, or the tile is no int from 1 to `MAX_TILE`.
    """

    def __init__(self, network: DetectorLike, tile: int | None = None) -> None:
        refuse_training_mode(network, "detector")
        self.network = network
        self.tile = _default_tile(network) if tile is None else checked_tile(tile, "detector")

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the network's weights, None where they are unknown."""
        return fingerprint(self.network)

    def start(self, count: int) -> None:
        """Begin with `count` new images; the detector remembers no others."""

    def act(self, episodes: Sequence[Frame], which: Indices | None = None) -> list[Detections]:
        """Detect objects in images of one size.

        Args:
            episodes: The images.
            which: Indices of those to look at; by default all.

        Raises:
            UserError: If the network breaks torchvision's convention.
        """
        chosen = episodes if which is None else [episodes[i] for i in which.tolist()]
        return list(chain(*tiled(self._call, {"image": np.stack(chosen)}, self.tile, blank=True)))

    def _call(self, batch: Batch) -> list[Detections]:
        import torch

        images = [
            torch.from_numpy(image).permute(2, 0, 1).float().div(255).contiguous()
            for image in batch["image"]
        ]
        with torch.inference_mode():
            return _checked(self.network(images), len(images))


def _default_tile(network: DetectorLike) -> int:
    from sada_gym.envs.detection.agent.network import Detector

    return DETECTOR_TILE if isinstance(network, Detector) else 1


def listed(detections: Detections) -> list[dict[str, Any]]:
    """Make one dictionary of each detection, best first: `box`, `label`, `score`."""
    columns = (detections[key].tolist() for key in ("boxes", "labels", "scores"))
    return [
        {"box": box, "label": label, "score": score}
        for box, label, score in zip(*columns, strict=True)
    ]


def _checked(detections: Any, count: int) -> list[Detections]:
    """Give the detections of a tile as arrays, best first; name what breaks the convention."""
    convention = (
        "The detector must return, as torchvision's do, one dictionary an image with "
        "boxes (N, 4), labels (N,) and scores (N,) in [0, 1]."
    )
    if not isinstance(detections, Sequence) or len(detections) != count:
        what = f"{len(detections)} items" if hasattr(detections, "__len__") else type(detections)
        raise UserError(
            f"Expected {count} dictionaries from the detector, got {what}. {convention}"
        )
    checked = []
    for item in detections:
        missing = {"boxes", "labels", "scores"} - set(item)
        if missing:
            raise UserError(
                f"Expected {', '.join(sorted(missing))} from the detector. {convention}"
            )
        boxes, labels, scores = (
            item[key].detach().cpu().numpy() for key in ("boxes", "labels", "scores")
        )
        if boxes.shape != (len(scores), 4) or labels.shape != scores.shape or scores.ndim != 1:
            raise UserError(
                f"Expected boxes (N, 4), labels (N,), scores (N,) from the detector, got "
                f"{boxes.shape}, {labels.shape}, {scores.shape}. {convention}"
            )
        if not ((scores >= 0) & (scores <= 1)).all():
            raise UserError(
                f"Expected scores in [0, 1] from the detector, got {scores}. {convention}"
            )
        if not np.isfinite(boxes).all():
            raise UserError(
                f"Expected boxes of finite numbers from the detector, got {boxes}. {convention}"
            )
        best = np.argsort(-scores, kind="stable")[:TOP_DETECTIONS]
        checked.append({"boxes": boxes[best], "labels": labels[best], "scores": scores[best]})
    return checked
