"""Pilots in files: weights alone, as safetensors; their names tell which kind of pilot it is."""

from __future__ import annotations

from pathlib import Path

from safetensors.torch import save_file
from stable_baselines3 import PPO

from sada_gym.agents.weights import load_weights, read_weights
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_network
from sada_gym.envs.uav.agent.reinforcement import new_model


def save(pilot: WaypointNetwork | PPO, path: Path) -> None:
    """Write a pilot's weights."""
    weights = (pilot if isinstance(pilot, WaypointNetwork) else pilot.policy).state_dict()
    save_file({key: value.contiguous() for key, value in weights.items()}, path)


def load(path: Path) -> WaypointNetwork | PPO:
    """Read a pilot's weights; their names tell which kind it is.

    Raises:
        ValueError: If the file holds no weights of a pilot.
    """
    weights, _ = read_weights(path, "the weights of a pilot")
    if any(key.startswith("convolutions.") for key in weights):
        network = new_network(0)
        load_weights(network, path, "the weights of a pilot like waypoint-pid")
        return network.eval()
    model = new_model(0)
    load_weights(model.policy, path, "the weights of a pilot like ppo")
    return model
