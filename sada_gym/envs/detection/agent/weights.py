"""Detectors in files: weights alone, as safetensors."""

from __future__ import annotations

from pathlib import Path

from sada_gym.agents.weights import WeightsFile, load_weights
from sada_gym.envs.detection.agent.network import Detector
from sada_gym.envs.detection.shapes.catalogue import CLASSES


def load(path: Path) -> Detector:
    """Read a trained detector, frozen and ready to detect.

    Raises:
        FileError: If the file does not hold this network's weights.
    """
    model, content = Detector(CLASSES), f"the weights of the {len(CLASSES)}-class Detector"
    load_weights(model, WeightsFile(path, content, "detector", "studies.training.detection.train"))
    return model.eval().requires_grad_(False)
