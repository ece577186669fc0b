"""The pilots' networks: one that sees where the next gate is, and one that chooses actions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from stable_baselines3 import PPO
from torch import Tensor, nn

from sada_gym.agents.shipped_policy import ShippedPolicy
from sada_gym.agents.weights import WeightsFile, load_weights, read_weights, save_weights
from sada_gym.envs.uav.camera.pinhole import COLUMNS, ROWS
from sada_gym.envs.uav.task import RacingTaskEnv
from sada_gym.foundations.determinism import generators_kept

_LOG_NOISE = -1.0
"""The logarithm of the noise on actions with which PPO begins. The noise is 0.37; with SB3's own,
1, few drones reach a gate."""
_TRAINED_BY = ("pilot", "studies.training.uav.train")
MOTIONS = 9
"""The length of the drone's own motion: which way is up, its velocity, its turning."""


class WaypointNetwork(nn.Module):
    """Says where the next gate is: four convolutions over the image, joined with the motion.

    All is in the drone's own frame: x ahead, y to the left, z up, as the drone leans.
    """

    architecture: ClassVar[str] = "sada_gym waypoint network"

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
        # attributes name the weights in files: `seen` reads the image, `motion` the drone's motion
        self.seen = nn.Sequential(nn.Linear(flat, 128), nn.ReLU())
        self.motion = nn.Sequential(nn.Linear(MOTIONS, 32), nn.ReLU())
        self.head = nn.Sequential(nn.Linear(160, 64), nn.ReLU(), nn.Linear(64, 6))

    @staticmethod
    def has_weights(names: Iterable[str]) -> bool:
        """Say whether weights of these names are of such a network."""
        return any(name.startswith("convolutions.") for name in names)

    def forward(self, light: Tensor, motion: Tensor) -> Tensor:
        """Say where the next gate is.

        `light` (n, 3, rows, columns) in [0, 1]; `motion` (n, 9), see `drone_frame.motion`. Returns
        (n, 6): the opening's centre in 10 m, and the direction in which to pass it.
        """
        image = self.seen(self.convolutions(light - 0.5))
        joint = torch.cat([image, self.motion(motion)], dim=1)
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


class PilotPolicy(ShippedPolicy):
    """Two layers of 64 units for the actions, and for the value."""

    architecture: ClassVar[str] = "sada_gym pilot"
    environment = RacingTaskEnv
    settings: ClassVar[Mapping[str, Any]] = {
        "net_arch": {"pi": [64, 64], "vf": [64, 64]},
        "log_std_init": _LOG_NOISE,
    }


new_model = PilotPolicy.new_model


def _block(inputs: int, outputs: int, *, kernel: int) -> list[nn.Module]:
    return [nn.Conv2d(inputs, outputs, kernel, stride=2, padding=kernel // 2), nn.ReLU()]


def save(pilot: WaypointNetwork | PPO, path: Path) -> None:
    """Write a pilot's weights."""
    save_weights(pilot if isinstance(pilot, WaypointNetwork) else pilot.policy, path)


def load(path: Path) -> WaypointNetwork | PPO:
    """Read a pilot's weights, whose names tell its kind; raise `FileError` if it has none."""
    weights, _ = read_weights(WeightsFile(path, "the weights of a pilot", *_TRAINED_BY))
    if WaypointNetwork.has_weights(weights):
        network, content = new_network(0), "the weights of a pilot like waypoint-pid"
        load_weights(network, WeightsFile(path, content, *_TRAINED_BY))
        return network.eval()
    model, content = new_model(0), "the weights of a pilot like ppo"
    load_weights(model.policy, WeightsFile(path, content, *_TRAINED_BY))
    return model
