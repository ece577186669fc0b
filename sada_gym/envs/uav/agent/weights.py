"""Pilots in files: weights alone, as safetensors; their names tell which kind of pilot it is."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3 import PPO

from sada_gym.agents.weights import WeightsFile, load_weights, read_weights, save_weights
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_model, new_network

_TRAINED_BY = ("pilot", "studies.training.uav.train")


def save(pilot: WaypointNetwork | PPO, path: Path) -> None:
    """Write a pilot's weights."""
    save_weights(pilot if isinstance(pilot, WaypointNetwork) else pilot.policy, path)


def load(path: Path) -> WaypointNetwork | PPO:
    """Read a pilot's weights; their names tell which kind it is.

    Raises:
        FileError: If the file holds no weights of a pilot.
    """
    weights, _ = read_weights(WeightsFile(path, "the weights of a pilot", *_TRAINED_BY))
    if WaypointNetwork.has_weights(weights):
        network, content = new_network(0), "the weights of a pilot like waypoint-pid"
        load_weights(network, WeightsFile(path, content, *_TRAINED_BY))
        return network.eval()
    model, content = new_model(0), "the weights of a pilot like ppo"
    load_weights(model.policy, WeightsFile(path, content, *_TRAINED_BY))
    return model
