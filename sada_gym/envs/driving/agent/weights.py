"""Drivers in files: the policy's weights, and in the header how its network is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stable_baselines3 import PPO

from sada_gym.agents.weights import WeightsFile, load_weights, save_weights
from sada_gym.envs.driving.agent.network import BRANCH_FEATURES, ConditionalExtractor, new_model
from sada_gym.envs.driving.episodes import OBSERVATION_SPACE

_MEND = (
    "Write such a file in the repository by python -m studies.training.driving.train, or, for a "
    "driver of your own, pass the model as agent=model."
)


def save(driver: PPO, path: Path) -> None:
    """Write a driver's weights."""
    save_weights(driver.policy, path, _architecture())


def load(path: Path) -> PPO:
    """Read a driver's weights.

    Raises:
        FileError: If the file holds no weights of a driver.
    """
    model = new_model(0)
    load_weights(model.policy, WeightsFile(path, "the weights of a driver", _MEND), _architecture())
    # as SB3 loads a model: with an environment its pictures would be transposed by that one's
    # wrapper, into another order in memory, for which convolutions give other last bits
    model.env = None
    return model


def _architecture() -> dict[str, Any]:
    return {
        "extractor": ConditionalExtractor.__name__,
        "branch_features": BRANCH_FEATURES,
        "observations": {
            key: list(space.shape or ()) for key, space in sorted(OBSERVATION_SPACE.spaces.items())
        },
    }
