"""What a detector answered, checked: a user's may answer anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError

KEYS = ("boxes", "labels", "scores")
"""What a detector tells of each image."""

CONVENTION = (
    "The detector must return, as torchvision's do, one dictionary an image with boxes (N, 4), "
    "labels (N,) and scores (N,) in [0, 1]."
)

Columns = dict[str, npt.NDArray[Any]]
"""One image's `boxes` (N, 4), `labels` (N,) and `scores` (N,), in the detector's order."""


def validate_answers(answers: Any, count: int) -> list[Columns]:
    """Return a detector's answers to `count` images as arrays, of tensors, arrays or lists.

    Raises:
        UserError: If the answers break torchvision's convention.
    """
    if isinstance(answers, str | bytes) or not isinstance(answers, Sequence):
        kind = type(answers).__name__
        raise UserError(f"Expected a list from the detector, got {kind}. {CONVENTION}")
    if len(answers) != count:
        raise UserError(
            f"Expected {count} dictionaries from the detector, got {len(answers)} items. "
            f"{CONVENTION}"
        )
    return [_validate(answer) for answer in answers]


def check_numbers(boxes: npt.NDArray[Any], scores: npt.NDArray[Any]) -> None:
    """Raise `UserError` for scores outside [0, 1], and for boxes that are not finite."""
    if not ((scores >= 0) & (scores <= 1)).all():
        raise UserError(f"Expected scores in [0, 1] from the detector, got {scores}. {CONVENTION}")
    if not np.isfinite(boxes).all():
        raise UserError(
            f"Expected boxes of finite numbers from the detector, got {boxes}. {CONVENTION}"
        )


def _validate(answer: Any) -> Columns:
    if not isinstance(answer, Mapping):
        kind = type(answer).__name__
        raise UserError(f"Expected a dictionary from the detector, got {kind}. {CONVENTION}")
    missing = [key for key in KEYS if key not in answer]
    if missing:
        raise UserError(f"Expected {', '.join(missing)} from the detector. {CONVENTION}")
    columns = {key: _numbers(key, answer[key]) for key in KEYS}
    boxes, labels, scores = columns.values()
    if not boxes.size and scores.shape == (0,):
        columns["boxes"] = boxes = boxes.reshape(0, 4)  # where nothing was found, as torchvision
    if scores.ndim != 1 or boxes.shape != (len(scores), 4) or labels.shape != scores.shape:
        raise UserError(
            f"Expected boxes (N, 4), labels (N,), scores (N,) from the detector, got "
            f"{boxes.shape}, {labels.shape}, {scores.shape}. {CONVENTION}"
        )
    if scores.dtype.kind != "f":
        columns["scores"] = scores = scores.astype(np.float64)  # unsigned ones would sort wrongly
    check_numbers(boxes, scores)
    if not (np.isfinite(labels) & (labels == np.floor(labels))).all():
        raise UserError(f"Expected whole labels from the detector, got {labels}. {CONVENTION}")
    return columns


def _numbers(key: str, given: Any) -> npt.NDArray[Any]:
    """Return real numbers as an array; those of other formats than NumPy's as float32."""
    import torch

    kind = type(given).__name__
    if isinstance(given, torch.Tensor):
        given = given.detach()
        if given.is_floating_point() and given.element_size() < 4:
            given = given.float()  # NumPy has no bfloat16
        given = given.cpu().numpy()
    values: npt.NDArray[Any] = np.asarray(given)
    if values.dtype.kind not in "iuf":
        raise UserError(
            f"Expected {key} of real numbers from the detector, got {kind} of "
            f"{values.dtype}. {CONVENTION}"
        )
    return values
