"""What a detector did: which class it saw in the place of the true one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.foundations.behaviour import Behaviour

_OVERLAP = 0.5
"""The least intersection over union of the object's box and that of a detection in its place."""


def behaviour(
    info: Mapping[str, Any], label: int, names: Mapping[int, str], threshold: float
) -> Behaviour:
    """Say what a detector saw, by the info of an evaluation.

    `label` is that of the true class, `names` those of all labels as far as they are known. What
    has a confidence of at most `threshold` does not count as seen.
    """
    name, best = names[label], info["detections"]
    if not info["fooled"]:
        return Behaviour(f"seen as {name} ({info['score']:.2f})")
    if not np.any(info["box"]):
        event = "out of sight"
        return Behaviour(event, (event,), data={"seen_as": None, "confidence": None})
    instead = [
        detection
        for detection in best
        if detection["label"] != label
        and detection["score"] > threshold
        and _overlap(detection["box"], info["box"]) >= _OVERLAP
    ]
    guess = f"{name} at {info['score']:.2f}"
    if not instead:
        data = {"seen_as": None, "confidence": None}
        return Behaviour(f"not seen ({guess})", ("not seen",), data=data)
    first = max(instead, key=lambda detection: detection["score"])
    seen = names.get(first["label"], f"label {first['label']}")
    return Behaviour(
        f"seen as {seen} ({first['score']:.2f}; {guess})",
        (f"seen as {seen}",),
        data={"seen_as": seen, "confidence": float(first["score"])},
    )


def _overlap(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    boxes = np.array([first, second], np.float64)
    low, high = boxes[:, :2], boxes[:, 2:]
    shared = np.prod(np.maximum(high.min(axis=0) - low.max(axis=0), 0.0))
    union = np.prod(np.maximum(high - low, 0.0), axis=1).sum() - shared
    return float(shared / union) if union > 0.0 else 0.0
