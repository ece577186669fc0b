"""Classifiers in files: weights alone, as safetensors."""

from __future__ import annotations

from pathlib import Path

from sada_gym.agents.weights import WeightsFile, load_weights
from sada_gym.envs.digits.agent.network import DigitNetwork, new_network

_MEND = (
    "Write such a file in the repository by python -m studies.training.digits.train, or, for a "
    "classifier of your own, pass the model as agent=model."
)


def load(path: Path) -> DigitNetwork:
    """Read a trained classifier, frozen and ready to classify.

    Raises:
        FileError: If the file does not hold this network's weights.
    """
    network = new_network(0)
    load_weights(network, WeightsFile(path, "the weights of a classifier of digits", _MEND))
    return network.eval().requires_grad_(False)
