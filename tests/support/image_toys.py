"""Images and models for tests of `ImageApplication`: a bright square on grey, and who finds it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

SIZE = 96, 128


def square(x: int, y: int, side: int = 24, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Draw a bright square, its upper left corner at x, y, on a grey gradient."""
    image = np.empty((*size, 3), np.uint8)
    image[:] = np.linspace(60, 110, size[0]).astype(np.uint8)[:, None, None]
    image[y : y + side, x : x + side] = 240
    return image


def squares(count: int = 6) -> tuple[list[np.ndarray], list[dict[str, Any]]]:
    """Draw images of one square each, and their labels."""
    rng = np.random.default_rng(0)
    places = [(int(rng.integers(20, 80)), int(rng.integers(20, 50))) for _ in range(count)]
    labels = [{"boxes": [[x, y, x + 24, y + 24]], "labels": [1]} for x, y in places]
    return [square(x, y) for x, y in places], labels


def find_square(images: list[torch.Tensor]) -> list[dict[str, torch.Tensor]]:
    """Find what is bright, as torchvision's detectors answer."""
    answers = []
    for image in images:
        rows, columns = (image.mean(0) > 0.8).nonzero().unbind(1)
        if not len(rows):
            answers.append({"boxes": torch.zeros(0, 4), "labels": torch.zeros(0), "scores": rows})
            continue
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        answers.append(
            {
                "boxes": torch.tensor([box], dtype=torch.float32),
                "labels": torch.tensor([1]),
                "scores": torch.tensor([0.9]),
            }
        )
    return answers


class Halves(nn.Module):
    """Says whether an image is brighter in its left half (class 0) or its right one (class 1)."""

    labels = {"left": 0, "right": 1}  # noqa: RUF012 - as torchvision's models have them

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.tensor(20.0))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return the logits, (n, 2)."""
        middle = images.shape[3] // 2
        left, right = images[..., :middle].mean((1, 2, 3)), images[..., middle:].mean((1, 2, 3))
        return self.scale * torch.stack([left - right, right - left], 1)
