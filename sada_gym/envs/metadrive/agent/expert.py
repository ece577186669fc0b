"""MetaDrive's PPO expert: three dense layers, out of the package `metadrive-simulator`.

The network is computed here, in a kernel, so that an action does not depend on BLAS. A test
compares it with the package's own `numpy_expert`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sada_gym.agents.layers import forward
from sada_gym.envs.metadrive.episodes import DriveEpisodes
from sada_gym.foundations.arrays import Floats, Indices
from sada_gym.foundations.compiled import kernel

_LAYERS = tuple(f"default_policy/fc_{name}" for name in ("1", "2", "out"))
_TURNED = [10, 15]
"""Numbers of the observation whose sign MetaDrive changed after the expert's training."""


class Expert:
    """The expert, which takes its best action.

    Args:
        weights: The kernels, (inputs, outputs), of its three layers.
        biases: Their biases.
    """

    def __init__(self, weights: tuple[Floats, ...], biases: tuple[Floats, ...]) -> None:
        self._layers = [*zip(weights, biases, strict=True)]
        parts = [array.tobytes() for array in (*weights, *biases)]
        self.fingerprint = hashlib.sha256(b"".join(parts)).hexdigest()

    def start(self, count: int) -> None:
        """Begin new drives, of which nothing is kept."""

    def act(self, episodes: DriveEpisodes, which: Indices) -> Floats:
        """Return the actions (n, 2) in some of the drives."""
        seen = episodes.observe(which)
        inputs = np.concatenate([seen["state"], seen["lidar"]], axis=1).astype(np.float64)
        inputs[:, _TURNED] = 1.0 - inputs[:, _TURNED]
        return np.stack([forward(row, self._layers, _tanh)[:2] for row in inputs])


def load(files: Mapping[str, Path]) -> Expert:
    """Read the expert from the installed package's file."""
    (path,) = files.values()
    with np.load(path) as file:
        weights = [np.ascontiguousarray(file[f"{name}/kernel"], np.float64) for name in _LAYERS]
        biases = [file[f"{name}/bias"].astype(np.float64) for name in _LAYERS]
    return Expert(tuple(weights), tuple(biases))


@kernel
def _tanh(values: Floats) -> None:
    """Apply the hyperbolic tangent in place."""
    for unit in range(len(values)):
        values[unit] = math.tanh(values[unit])
