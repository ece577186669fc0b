"""Pilots in files: weights alone, as safetensors; their names tell which kind of pilot it is."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3 import PPO

from sada_gym.agents.weights import WeightsFile, load_weights, read_weights, save_weights
from sada_gym.envs.uav.agent.network import WaypointNetwork, new_model, new_network

_MEND = (
    "Write such a file in the repository by python -m studies.training.uav.train, or, for a "
    "pilot of your own, pass the model as agent=model."
)


def save(pilot: WaypointNetwork | PPO, path: Path) -> None:
    """Write a pilot's weights."""
    save_weights(pilot if isinstance(pilot, WaypointNetwork) else pilot.policy, path)


def load(path: Path) -> WaypointNetwork | PPO:
    """Read a pilot's weights; their names tell which kind it is.

    Raises:
        FileError: If the file holds no weights of a pilot.
    """
    weights, _ = read_weights(WeightsFile(path, "the weights of a pilot", _MEND))
    if WaypointNetwork.has_weights(weights):
        network = new_network(0)
        file = WeightsFile(path, "the weights of a pilot like waypoint-pid", _MEND)
        load_weights(network, file)
        return network.eval()
    model = new_model(0)
    load_weights(model.policy, WeightsFile(path, "the weights of a pilot like ppo", _MEND))
    return model
