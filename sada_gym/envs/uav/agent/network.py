"""The perception network: from a picture and the drone's own motion to where the next gate is."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from sada_gym.determinism import generators_kept
from sada_gym.envs.uav.camera.pinhole import COLUMNS, ROWS

MOTIONS = 9
"""What the drone feels: which way is up, its velocity, its turning."""


class WaypointNetwork(nn.Module):
    """Four convolutions over the picture, joined with the motion; all in the drone's own frame.

    The frame is x ahead, y to the left, z up, as the drone leans.
    """

    # where the class stood when the published results were made: fingerprints hold this name
    fingerprint_name: ClassVar[str] = "sada_gym.agents.pilot.network.WaypointNetwork"

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            *_block(3, 16, kernel=5),
            *_block(16, 32, kernel=3),
            *_block(32, 48, kernel=3),
            *_block(48, 64, kernel=3),
            nn.Flatten(),
        )
        with torch.no_grad():
            flat = self.convolutions(torch.zeros(1, 3, ROWS, COLUMNS)).shape[1]
        self.seen = nn.Sequential(nn.Linear(flat, 128), nn.ReLU())
        self.felt = nn.Sequential(nn.Linear(MOTIONS, 32), nn.ReLU())
        self.head = nn.Sequential(nn.Linear(160, 64), nn.ReLU(), nn.Linear(64, 6))

    def forward(self, light: Tensor, motion: Tensor) -> Tensor:
        """Say where the next gate is.

        Args:
            light: (n, 3, rows, columns) in [0, 1].
            motion: (n, 9) of `motion`.

        Returns:
            (n, 6): the opening's centre in 10 m, and the direction in which to pass it.
        """
        seen = self.seen(self.convolutions(light - 0.5))
        joint = torch.cat([seen, self.felt(motion)], dim=1)
        answer: Tensor = self.head(joint)
        return answer


def new_network(seed: int) -> WaypointNetwork:
    """Make an untrained network; the seed fixes its weights."""
    with generators_kept():
        torch.manual_seed(seed)
        return WaypointNetwork()


def light(pictures: Tensor) -> Tensor:
    """Turn bytes (n, rows, columns, 3) into what the network takes."""
    return pictures.permute(0, 3, 1, 2).to(torch.float32) / 255


def _block(inputs: int, outputs: int, *, kernel: int) -> list[nn.Module]:
    return [nn.Conv2d(inputs, outputs, kernel, stride=2, padding=kernel // 2), nn.ReLU()]
