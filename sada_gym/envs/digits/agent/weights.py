"""Classifiers in files: weights alone, as safetensors."""

from __future__ import annotations

from pathlib import Path

from sada_gym.agents.weights import WeightsFile, load_weights
from sada_gym.envs.digits.agent.network import DigitNetwork, new_network


def load(path: Path) -> DigitNetwork:
    """Read a trained classifier, frozen and ready to classify.

    Raises:
        FileError: If the file does not hold this network's weights.
    """
    network, content = new_network(0), "the weights of a classifier of digits"
    load_weights(network, WeightsFile(path, content, "classifier", "studies.training.digits.train"))
    return network.eval().requires_grad_(False)
