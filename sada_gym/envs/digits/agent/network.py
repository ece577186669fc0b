"""The classifier under attack: two convolutions and two linear layers."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn

from sada_gym.agents.weights import WeightsFile, load_weights
from sada_gym.foundations.determinism import generators_kept

CLASSES = 10


class DigitNetwork(nn.Module):
    """Classifies 8 x 8 grey images of digits."""

    architecture: ClassVar[str] = "sada_gym digits"

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(1, 16, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(512, 64),
            nn.ReLU(),
            nn.Linear(64, CLASSES),
        )

    def forward(self, images: Tensor) -> Tensor:
        """Return the logits (B, 10) of images (B, 1, 8, 8) in [0, 1]."""
        logits: Tensor = self.layers(images - 0.5)
        return logits


def new_network(seed: int) -> DigitNetwork:
    """Make an untrained network; the seed fixes its weights."""
    with generators_kept():
        torch.manual_seed(seed)
        return DigitNetwork()


def load(path: Path) -> DigitNetwork:
    """Read a trained classifier, frozen; raise `FileError` if the file holds other weights."""
    network, content = new_network(0), "the weights of a classifier of digits"
    load_weights(network, WeightsFile(path, content, "classifier", "studies.training.digits.train"))
    return network.eval().requires_grad_(False)
