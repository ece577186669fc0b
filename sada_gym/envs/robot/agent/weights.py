"""Robots in files: the policy's weights, and in the header how its network is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stable_baselines3 import PPO

from sada_gym.agents.weights import WeightsFile, load_weights, save_weights
from sada_gym.envs.robot.agent.network import LAYERS, new_model
from sada_gym.envs.robot.episodes import OBSERVATION_SPACE

_MEND = (
    "Write such a file in the repository by python -m studies.training.robot.train, or, for a "
    "robot of your own, pass the model as agent=model."
)


def save(robot: PPO, path: Path) -> None:
    """Write a robot's weights."""
    save_weights(robot.policy, path, _architecture())


def load(path: Path) -> PPO:
    """Read a robot's weights.

    Raises:
        FileError: If the file holds no weights of a robot.
    """
    model = new_model(0)
    load_weights(model.policy, WeightsFile(path, "the weights of a robot", _MEND), _architecture())
    model.env = None  # as SB3 loads a model
    return model


def _architecture() -> dict[str, Any]:
    return {
        "layers": list(LAYERS),
        "observations": {
            key: list(space.shape or ()) for key, space in sorted(OBSERVATION_SPACE.spaces.items())
        },
    }
