"""The detector under attack is a small single-stage network, called as torchvision's detectors are.

It is CenterNet (Zhou et al. 2019) with the box regression of FCOS (Tian et al. 2019): one heat map
for each class says where centres lie, and four more channels say how far boxes reach from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from sada_gym.agents.weights import WeightsFile, load_weights
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from sada_gym.errors import UserError

STRIDE = 8
"""Pixels per cell of the heat map."""

MULTIPLE = 16
"""Height and width of an image are multiples of this, so that both scales of the network fit."""

MIDDLE, SPREAD = 0.5, 0.25
"""What the layers take for zero and one, of colours in [0, 1]."""


class Block(nn.Sequential):
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, *, stride: int = 1, kernel: int = 3) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two blocks around a skip."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(Block(channels, channels), Block(channels, channels))

    def forward(self, x: Tensor) -> Tensor:
        """Add the body to its input."""
        change: Tensor = self.body(x)
        return x + change


class Detector(nn.Module):
    """Detects the classes it was trained on.

    It is called as torchvision's detectors are: `model(images)` takes a list of (3, H, W) float
    tensors in [0, 1] and returns a list of {"boxes": (N, 4) x0 y0 x1 y1 in pixels, "labels": (N,)
    int64 from 1, "scores": (N,) in [0, 1], best first}. H and W are multiples of 16, equal in one
    call. Label i + 1 is classes[i]. An image has at most `top` detections, none with a score below
    `floor`.
    """

    def __init__(self, classes: Sequence[str], *, top: int = 10, floor: float = 0.05) -> None:
        super().__init__()
        self.labels = {name: i + 1 for i, name in enumerate(classes)}
        self.top, self.floor = top, floor
        self.fine = nn.Sequential(
            Block(3, 16, stride=2),
            Block(16, 32, stride=2),
            Block(32, 48, stride=2),
            Residual(48),
        )
        self.coarse = nn.Sequential(Block(48, 96, stride=2), Residual(96), Block(96, 48, kernel=1))
        self.neck = Block(48, 64)
        self.head = nn.Conv2d(64, len(classes) + 4, 1)
        nn.init.constant_(self.head.bias[: len(classes)], -4.0)  # type: ignore[index]

    @property
    def architecture(self) -> str:
        """The name that a fingerprint holds beside the weights, and the settings."""
        return f"sada_gym detector, top {self.top}, floor {self.floor}"

    def maps(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Map a batch (b, 3, H, W) in [0, 1] to class logits (b, k, h, w) and reach (b, 4, h, w).

        The reach is the logarithm of the distance from a cell's centre to the box's left, top,
        right and bottom, in cells.
        """
        return self.layers((images - MIDDLE) / SPREAD)

    def layers(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map normalised images (b, 3, H, W), zero on average, to what `maps` returns."""
        fine = self.fine(x)
        coarse = functional.interpolate(self.coarse(fine), scale_factor=2.0, mode="nearest")
        out = self.head(self.neck(fine + coarse))
        return out[:, :-4], out[:, -4:].clamp(-4, 4)

    def candidates(self, logits: Tensor, reach: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the highest peaks of what `maps` returned, best first, doubles among them.

        These are boxes (b, top, 4) in pixels, labels (b, top) and scores (b, top).
        """
        heat = logits.contiguous().sigmoid()
        scores, index = (heat * peaks(heat)).flatten(1).topk(self.top)
        cells = heat.shape[2] * heat.shape[3]
        return boxes_at(reach, index % cells), index // cells + 1, scores

    def forward(self, images: Sequence[Tensor]) -> list[dict[str, Tensor]]:
        """Detect: see the class.

        Raises:
            UserError: If H or W is not a multiple of 16.
        """
        batch = torch.stack(list(images))
        check_size(*batch.shape[2:])
        boxes, labels, scores = self.candidates(*self.maps(batch))
        kept = unique(boxes, labels, scores >= self.floor)
        return [
            {"boxes": boxes[k, keep], "labels": labels[k, keep], "scores": scores[k, keep]}
            for k, keep in enumerate(kept)
        ]


def check_size(height: int, width: int) -> None:
    """Raise `UserError` for images whose sides are not multiples of 16 pixels."""
    if height % MULTIPLE or width % MULTIPLE:
        raise UserError(
            f"Expected images whose sides are multiples of {MULTIPLE} pixels for this detector, "
            f"got {height} x {width}. Take 96, 112 or 128 pixels, for example, or bring a detector "
            "of your own that takes other sizes."
        )


def peaks(heat: Tensor) -> Tensor:
    """Say where heat maps (b, k, h, w), from 0 up, are as high as all their 8 neighbours.

    Four maxima of shifted maps are ten times as fast as torch's pooling.
    """
    wide = functional.pad(heat, (1, 1, 1, 1))
    rows = torch.maximum(torch.maximum(wide[..., :-2], wide[..., 1:-1]), wide[..., 2:])
    highest = torch.maximum(torch.maximum(rows[:, :, :-2], rows[:, :, 1:-1]), rows[:, :, 2:])
    return heat == highest


def boxes_at(reach: Tensor, cell: Tensor) -> Tensor:
    """Return the boxes (b, n, 4) in pixels at cells (b, n) of a reach map (b, 4, h, w)."""
    width = reach.shape[3]
    spread = reach.flatten(2).gather(2, cell[:, None].expand(-1, 4, -1)).exp()
    x, y = cell % width + 0.5, torch.div(cell, width, rounding_mode="floor") + 0.5
    left, top, right, bottom = spread.unbind(1)
    return STRIDE * torch.stack([x - left, y - top, x + right, y + bottom], 2)


def unique(boxes: Tensor, labels: Tensor, alive: Tensor, overlap: float = 0.5) -> Tensor:
    """Say which of boxes (b, n, 4), best first, with labels (b, n) are the best where they lie.

    A box is left out if it is not `alive`, (b, n) bool, or overlaps a better one of its class by
    more than `overlap`.
    """
    doubles = iou(boxes[:, :, None], boxes[:, None]) > overlap
    doubles &= labels[:, :, None] == labels[:, None]
    kept = alive.clone()
    for i in range(1, boxes.shape[1]):
        kept[:, i] &= ~(doubles[:, i, :i] & kept[:, :i]).any(1)
    return kept


def iou(a: Tensor, b: Tensor) -> Tensor:
    """Return the intersection over union of boxes (..., 4)."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    shared = (high - low).clamp(min=0).prod(-1)
    whole = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1)
    return shared / (whole - shared).clamp(min=1e-9)


def load(path: Path) -> Detector:
    """Read a trained detector, frozen and ready to detect.

    Raises:
        FileError: If the file does not hold this network's weights.
    """
    model, content = Detector(CLASSES), f"the weights of the {len(CLASSES)}-class Detector"
    load_weights(model, WeightsFile(path, content, "detector", "studies.training.detection.train"))
    return model.eval().requires_grad_(False)
