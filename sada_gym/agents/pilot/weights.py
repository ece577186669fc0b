"""Pilots in files: weights alone, as safetensors, so that a file can run no code."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO

from sada_gym.agents.pilot.network import WaypointNetwork, new_network
from sada_gym.agents.pilot.reinforcement import new_model


def save(pilot: WaypointNetwork | PPO, path: Path) -> None:
    """Write a pilot's weights."""
    weights = (pilot if isinstance(pilot, WaypointNetwork) else pilot.policy).state_dict()
    save_file({key: value.contiguous() for key, value in weights.items()}, path)


def load(path: Path) -> WaypointNetwork | PPO:
    """Read a pilot's weights; their names tell which kind it is.

    Raises:
        ValueError: If the file holds no weights of a pilot.
    """
    try:
        weights = load_file(path)
        if any(key.startswith("convolutions.") for key in weights):
            network = new_network(0)
            network.load_state_dict(weights)
            return network.eval()
        model = new_model(0)
        model.policy.load_state_dict(weights)
    except (SafetensorError, RuntimeError) as error:
        raise ValueError(
            f"Expected the weights of a pilot in {path}, got something else: {error}"
        ) from None
    return model
