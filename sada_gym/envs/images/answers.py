"""What a model tells of an image, compared with what is in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.detector import CONVENTION, validate_answers
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools, Floats

CONVENTIONS = {
    "classify": "The classifier must take (1, 3, height, width) float32 and return (1, K) numbers, "
    "one for each of K classes.",
    "detect": CONVENTION,
}
"""What each kind of model must return."""

FAINT = 0.01
"""Answers of a detector with a lower score are as good as none."""

_SUMS_TO_ONE = 1e-3


@dataclass(frozen=True)
class Found:
    """What a detector tells of an image, or a classifier: then with one class and no box.

    Attributes:
        classes: (k,) int64.
        scores: (k,) in [0, 1].
        boxes: (k, 4) x0 y0 x1 y1 in px; (0, 4) of a classifier.
        probabilities: (K,) of a classifier; (0,) of a detector.
    """

    classes: npt.NDArray[np.int64]
    scores: Floats
    boxes: Floats
    probabilities: Floats


def classified(output: Any) -> Found:
    """Return a classifier's answer of its output (1, K) or (K,), logits or probabilities.

    Raises:
        UserError: If it is of another shape, or not finite.
    """
    from torch import Tensor

    values = np.asarray(output.detach().double().cpu() if isinstance(output, Tensor) else output)
    numbers = values.reshape(-1).astype(np.float64) if values.dtype.kind in "iuf" else values
    if values.ndim not in (1, 2) or (values.ndim == 2 and len(values) != 1) or numbers.size < 2:
        raise UserError(
            f"Expected (1, K) numbers from the classifier, K of at least 2, got {values.shape}. "
            f"{CONVENTIONS['classify']}"
        )
    if values.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise UserError(
            f"Expected finite numbers from the classifier, got NaN, infinity or {values.dtype}. "
            f"{CONVENTIONS['classify']}"
        )
    shares = numbers
    if (numbers < 0.0).any() or abs(numbers.sum() - 1.0) > _SUMS_TO_ONE:
        shares = np.exp(numbers - numbers.max())
        shares /= shares.sum()
    best = int(shares.argmax())
    return Found(np.array([best]), shares[[best]], np.zeros((0, 4)), shares)


def detected(answers: Any) -> Found:
    """Return a detector's answer of its list of one dictionary, as torchvision's detectors give it.

    Raises:
        UserError: If it breaks that convention, or a box ends before it begins.
    """
    (columns,) = validate_answers(answers, 1)
    boxes, scores = (columns[key].astype(np.float64) for key in ("boxes", "scores"))
    kept = scores >= FAINT
    swapped = kept & (boxes[:, :2] > boxes[:, 2:]).any(axis=1)
    if swapped.any():
        raise UserError(
            "Expected boxes x0 y0 x1 y1 with x0 <= x1 and y0 <= y1 from the detector, got "
            f"{boxes[swapped][0].tolist()}. If it is x y width height, convert it."
        )
    return Found(columns["labels"].astype(np.int64)[kept], scores[kept], boxes[kept], np.zeros(0))


def overlaps(boxes: Floats, others: Floats) -> Floats:
    """Return the intersection over union of boxes (n, 4) and (m, 4), (n, m)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    shared = np.clip(high - low, 0.0, None).prod(axis=2)
    areas = [np.clip(b[:, 2:] - b[:, :2], 0.0, None).prod(axis=1) for b in (boxes, others)]
    union = areas[0][:, None] + areas[1][None] - shared
    iou: Floats = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0.0)
    return iou


def matched(
    classes: npt.NDArray[np.int64], boxes: Floats, found: Found, least_iou: float
) -> tuple[Bools, Bools]:
    """Say which true objects were found, (n,), and which answers are right, (m,).

    As COCO's evaluation does it: answers in the order of their scores take the object of their
    class that they overlap most, at least by `least_iou`, and that none has taken.
    """
    seen, right = np.zeros(len(classes), np.bool_), np.zeros(len(found.scores), np.bool_)
    iou = overlaps(found.boxes, boxes)
    iou[found.classes[:, None] != classes[None]] = -1.0
    for answer in np.argsort(-found.scores, kind="stable").tolist():
        free = np.where(seen, -1.0, iou[answer])
        best = int(free.argmax()) if len(free) else -1
        if best >= 0 and free[best] >= least_iou:
            seen[best] = right[answer] = True
    return seen, right


def visible(boxes: Floats, columns: int, rows: int, covered: tuple[tuple[int, ...], ...]) -> Bools:
    """Say of which boxes, (n, 4), at least half lies in the image and behind nothing."""
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    inside = boxes.clip(0.0, [columns, rows, columns, rows])
    left = (inside[:, 2:] - inside[:, :2]).prod(axis=1)
    for box in covered:
        low = np.maximum(inside[:, :2], np.array(box[:2]))
        high = np.minimum(inside[:, 2:], np.array(box[2:]))
        left = left - np.clip(high - low, 0.0, None).prod(axis=1)
    seen: Bools = (left >= 0.5 * areas) & (areas > 0.0)
    return seen
