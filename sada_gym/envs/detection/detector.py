"""The detector as the application calls it: in tiles, and with what it holds and gives checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Frame
from sada_gym.determinism import one_thread
from sada_gym.envs.checks import refuse_training_mode
from sada_gym.errors import UserError

if TYPE_CHECKING:
    from torch import Tensor

TILE = 14
"""Images in one call of a detector of the shipped architecture; a part of the benchmark's scores.
Larger tiles make a batch cheaper and a single evaluation dearer."""

TOP_DETECTIONS = 20
"""Detections an image that are looked at, best first."""

DetectorLike = Callable[[list["Tensor"]], Sequence[Mapping[str, "Tensor"]]]
"""Anything with torchvision's calling convention: see `Detector` in `agent/network.py`."""

Detections = dict[str, npt.NDArray[Any]]
"""One image's `boxes` (N, 4), `labels` (N,) and `scores` (N,), best first."""


def checked_detector(agent: DetectorLike) -> DetectorLike:
    """Give a user's detector back.

    Raises:
        UserError: If it is in training mode.
    """
    refuse_training_mode(agent, "detector")
    return agent


def default_tile(agent: DetectorLike) -> int:
    """The benchmark's tile for the shipped architecture, 1 for any other model."""
    from sada_gym.envs.detection.agent.network import Detector

    return TILE if isinstance(agent, Detector) else 1


def detect(agent: DetectorLike, images: Sequence[Frame], tile: int) -> list[Detections]:
    """Run a detector over images of one size, `tile` of them in each call.

    The last tile is filled up with black images.

    Raises:
        UserError: If the detector breaks torchvision's convention.
    """
    import torch

    found: list[Detections] = []
    for start in range(0, len(images), tile):
        chosen = [
            torch.from_numpy(image).permute(2, 0, 1).float().div(255).contiguous()
            for image in images[start : start + tile]
        ]
        padded = chosen + [torch.zeros_like(chosen[0])] * (tile - len(chosen))
        with torch.inference_mode(), one_thread():
            detections = agent(padded)
        found += _checked(detections, len(padded))[: len(chosen)]
    return found


def listed(detections: Detections) -> list[dict[str, Any]]:
    """One dictionary a detection, best first: `box`, `label`, `score`."""
    columns = (detections[key].tolist() for key in ("boxes", "labels", "scores"))
    return [
        {"box": box, "label": label, "score": score}
        for box, label, score in zip(*columns, strict=True)
    ]


def _checked(detections: Any, count: int) -> list[Detections]:
    """The detections of a tile as arrays, best first; what breaks the convention is named."""
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
