"""Pilots in files: weights alone, as safetensors, so that a file can run no code."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO
from torch import Tensor, nn

from sada_gym.agents.pilot.network import WaypointNetwork, new_network
from sada_gym.agents.pilot.reinforcement import new_model
from sada_gym.errors import UserError


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
    except SafetensorError as error:
        raise _no_pilot(path, f"got no safetensors file ({error})") from None
    if any(key.startswith("convolutions.") for key in weights):
        network = new_network(0)
        _fill(network, weights, path, "waypoint-pid")
        return network.eval()
    model = new_model(0)
    _fill(model.policy, weights, path, "ppo")
    return model


def _fill(module: nn.Module, weights: dict[str, Tensor], path: Path, kind: str) -> None:
    """Load a module's weights, or name the first that is missing, of another shape or unknown."""
    wanted = module.state_dict()
    for key, value in wanted.items():
        shape = tuple(value.shape)
        if key not in weights:
            raise _no_pilot(path, f"as {kind} has them: {key} of shape {shape}, got no {key}")
        if weights[key].shape != value.shape:
            found = tuple(weights[key].shape)
            raise _no_pilot(path, f"as {kind} has them: {key} of shape {shape}, got {found}")
    for key in weights:
        if key not in wanted:
            raise _no_pilot(path, f"as {kind} has them: without {key}, got one")
    module.load_state_dict(weights)


def _no_pilot(path: Path, why: str) -> UserError:
    return UserError(
        f"Expected the weights of a pilot in {path}, {why}. Write such a file by python -m "
        "sada_gym.agents.pilot.train, or, for a pilot of your own, pass the model as agent=model."
    )
