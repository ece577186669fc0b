"""The detector as the application calls it: in tiles, with what it holds and answers checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Indices
from sada_gym.agents.identity import fingerprint
from sada_gym.agents.tile import Batch, tiled
from sada_gym.envs.checks import check_evaluation_mode, check_tile
from sada_gym.errors import UserError, explained
from sada_gym.foundations.frames import Frame

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


if TYPE_CHECKING:
    from torch import Tensor

DETECTOR_TILE = 4
"""Images in one call of a detector of the shipped architecture; a part of the benchmark's scores.
With 8, a single evaluation takes two thirds more time, and an image of a batch a tenth less."""

TOP_DETECTIONS = 20
"""The most detections of an image that count, best first."""

DetectorLike = Callable[[list["Tensor"]], Sequence[Mapping[str, "Tensor"]]]
"""Anything with torchvision's calling convention: see `Detector` in `agent/network.py`."""

Detections = dict[str, npt.NDArray[Any]]
"""One image's `boxes` (N, 4), `labels` (N,) and `scores` (N,), best first."""


class DetectorAgent:
    """A detector that looks at images in tiles of one fixed size, filled up with black images.

    The shipped architecture is folded first, see `FoldedDetector`: later changes of its weights do
    not count. `tile` is by default `DETECTOR_TILE` for the shipped architecture, else 1;
    `image_size` is that of the images to come, if it is known and they are square. A detector that
    `scores_every_class` always keeps its best detection of the class with the `label`, if one is
    given, however many of other classes are better.

    Raises:
        UserError: If the network is in training mode, the tile is not an int from 1 to `MAX_TILE`,
            or the shipped architecture cannot take images of that size.
    """

    def __init__(
        self,
        network: DetectorLike,
        tile: int | None = None,
        image_size: int | None = None,
        *,
        label: int | None = None,
    ) -> None:
        from sada_gym.envs.detection.agent.folded import FoldedDetector
        from sada_gym.envs.detection.agent.network import Detector, check_size

        check_evaluation_mode(network, "detector")
        self.network = network
        self._kept_label = label if getattr(network, "scores_every_class", False) else None
        # a subclass may detect otherwise: it is called like any other detector
        self._folded = FoldedDetector(network) if type(network) is Detector else None
        default = 1 if self._folded is None else DETECTOR_TILE
        self.tile = default if tile is None else check_tile(tile, "detector")
        if self._folded is not None and image_size is not None:
            check_size(image_size, image_size)

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the network's weights, None where they are unknown."""
        return fingerprint(self.network)

    def start(self, count: int) -> None:
        """Begin with `count` new images; the detector remembers no others."""

    def act(self, episodes: Sequence[Frame], which: Indices | None = None) -> list[Detections]:
        """Detect objects in images of one size, or in some of them.

        Raises:
            UserError: If the network breaks torchvision's convention, or cannot take such images.
        """
        chosen = episodes if which is None else [episodes[i] for i in which.tolist()]
        batch = {"image": np.asarray(chosen)}
        if self._folded is None:
            return list(chain(*tiled(self._call, batch, self.tile, blank=True)))
        folded = self._folded
        candidates = np.concatenate(
            tiled(lambda tile: folded(tile["image"]), batch, self.tile, blank=True)
        )
        boxes, labels, scores = candidates[..., :4], candidates[..., 4], candidates[..., 5]
        check_numbers(boxes, scores)
        columns = {"boxes": boxes, "labels": labels.astype(np.int64), "scores": scores}
        best = [np.flatnonzero(kept)[:TOP_DETECTIONS] for kept in folded.kept(candidates)]
        return [
            {key: column[i, rows] for key, column in columns.items()} for i, rows in enumerate(best)
        ]

    def _call(self, batch: Batch) -> list[Detections]:
        import torch

        pixels = torch.from_numpy(batch["image"]).permute(0, 3, 1, 2)
        images = list(pixels.float().div(255).contiguous())
        expected = "Expected detections from the detector"
        with torch.inference_mode(), explained(expected, CONVENTION):
            answers = validate_answers(self.network(images), len(images))
        return [_best(answer, self._kept_label) for answer in answers]


def listed(detections: Detections) -> list[dict[str, Any]]:
    """Make one dictionary of each detection, best first: `box`, `label`, `score`."""
    columns = (detections[key].tolist() for key in KEYS)
    names = ("box", "label", "score")
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _best(answer: Detections, kept_label: int | None) -> Detections:
    labels, scores = answer["labels"], answer["scores"]
    order = np.argsort(-scores, kind="stable")
    best, own = order[:TOP_DETECTIONS], order[labels[order] == kept_label][:1]
    if len(own) and own[0] not in best:
        best = np.append(best[:-1], own)
    return {key: column[best] for key, column in answer.items()}
