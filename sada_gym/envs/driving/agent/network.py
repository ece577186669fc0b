"""The drivers' network: image and speed, then one branch for each command.

After the branched network of conditional imitation learning (Codevilla et al. 2018), with smaller
pictures. It is an SB3 features extractor: the branch of the command given keeps its features, the
others' are zero, so that the linear action layer behind it is one head a command.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from sada_gym.agents.shipped_policy import ShippedPolicy
from sada_gym.envs.driving.episodes import OBSERVATION_SPACE
from sada_gym.envs.driving.task import DrivingTaskEnv

BRANCH_FEATURES = 64
_LOG_NOISE = -2.0
"""The logarithm of the noise on actions with which reinforcement begins. The noise is 0.14; with
SB3's own, 1, no car stays in its lane long enough to learn from it."""


class ConditionalExtractor(BaseFeaturesExtractor):
    """Makes features of the image, the speed and the command, which is one-hot.

    Args:
        observation_space: The driving task's, its image transposed as SB3 does.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        command, image = observation_space["command"], observation_space["image"]
        assert command.shape is not None
        commands = command.shape[0]
        super().__init__(observation_space, features_dim=commands * BRANCH_FEATURES)
        self.convolutions = nn.Sequential(
            *_block(3, 24, kernel=5, stride=2),
            *_block(24, 36, kernel=5, stride=2),
            *_block(36, 48, kernel=3, stride=2),
            *_block(48, 64, kernel=3, stride=1),
            nn.Flatten(),
        )
        with torch.no_grad():
            flat = self.convolutions(torch.zeros(1, *image.shape)).shape[1]  # type: ignore[misc]
        # attributes are the weights' names in files: `seen` is the image's layer
        self.seen = nn.Sequential(nn.Linear(flat, 128), nn.ReLU())
        self.speed = nn.Sequential(nn.Linear(1, 16), nn.ReLU())
        self.branches = nn.ModuleList(
            nn.Sequential(nn.Linear(144, BRANCH_FEATURES), nn.ReLU()) for _ in range(commands)
        )

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Return the features (n, commands * BRANCH_FEATURES)."""
        image = self.seen(self.convolutions(observations["image"]))
        joint = torch.cat([image, self.speed(observations["speed"])], dim=1)
        command = observations["command"]
        features = [branch(joint) * command[:, i : i + 1] for i, branch in enumerate(self.branches)]
        return torch.cat(features, dim=1)


def _block(inputs: int, outputs: int, *, kernel: int, stride: int) -> list[nn.Module]:
    return [nn.Conv2d(inputs, outputs, kernel, stride=stride), nn.ReLU()]


class DriverPolicy(ShippedPolicy):
    """The command's branch of features, a linear layer, and a small value network."""

    architecture: ClassVar[str] = "sada_gym driver"
    environment = DrivingTaskEnv
    settings: ClassVar[Mapping[str, Any]] = {
        "net_arch": {"pi": [], "vf": [64]},
        "ortho_init": False,
        "log_std_init": _LOG_NOISE,
        "features_extractor_class": ConditionalExtractor,
    }
    kind, trained_by, seen = "driver", "studies.training.driving.train", OBSERVATION_SPACE
    built: ClassVar[Mapping[str, Any]] = {
        "extractor": ConditionalExtractor.__name__,
        "branch_features": BRANCH_FEATURES,
    }


new_model, save, load = DriverPolicy.new_model, DriverPolicy.save_model, DriverPolicy.load_model
