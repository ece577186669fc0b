"""RAPTOR: a dense layer, a GRU and a dense layer, out of the package `foundation-policy`.

The network is computed here, in a kernel and one flight after the other, so that an action depends
neither on the batch nor on BLAS nor on a processor's exponential function. A test compares it with
the package's own `evaluate_step`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sada_gym.agents.layers import dense, exponential
from sada_gym.envs.quadrotor.episodes import QuadrotorEpisodes
from sada_gym.foundations.arrays import Floats, Floats32, Indices
from sada_gym.foundations.compiled import kernel

_WEIGHTS = ("0/weights", "1/weights_input", "1/weights_hidden", "2/weights")
_BIASES = ("0/biases", "1/biases_input", "1/biases_hidden", "2/biases")
_INITIAL = "1/initial_hidden_state"
_UNITS = 16


class Raptor:
    """The recurrent policy; it keeps the state of each flight.

    Args:
        arrays: The weights by their path in the checkpoint's group `actor/layers`.
    """

    def __init__(self, arrays: Mapping[str, Floats32]) -> None:
        parts = [name.encode() + arrays[name].tobytes() for name in sorted(arrays)]
        self.fingerprint = hashlib.sha256(b"".join(parts)).hexdigest()
        self._initial = arrays[_INITIAL].astype(float)
        # transposed, so that a kernel adds a multiple of a row at a time
        self._weights = tuple(np.ascontiguousarray(arrays[name].T, float) for name in _WEIGHTS)
        self._biases = tuple(arrays[name].ravel().astype(float) for name in _BIASES)
        self.start(0)

    def start(self, count: int) -> None:
        """Begin `count` new flights."""
        self._states = np.tile(self._initial, (count, 1))

    def act(self, episodes: QuadrotorEpisodes, which: Indices) -> Floats:
        """Return the actions (n, 4) in some of the flights."""
        actions = np.empty((len(which), 4))
        observed = episodes.observe(which)["state"]
        _act(which, observed, self._states, self._weights, self._biases, actions)
        return actions


def load(files: Mapping[str, Path]) -> Raptor:
    """Read RAPTOR from the installed package's only file."""
    import h5py  # only this needs it

    (path,) = files.values()
    with h5py.File(path, "r") as file:
        layers, names = file["actor/layers"], (*_WEIGHTS, *_BIASES, _INITIAL)
        return Raptor({name: layers[f"{name}/parameters"][()] for name in names})


@kernel
def _act(
    which: Indices,
    observed: Floats32,
    states: Floats,
    weights: tuple[Floats, ...],
    biases: tuple[Floats, ...],
    actions: Floats,
) -> None:
    """Choose the actions (k, 4) in some flights, and change their `states` (n, 16) in place."""
    for row, i in enumerate(which):
        state = states[i]
        first = np.maximum(dense(observed[row].astype(np.float64), weights[0], biases[0]), 0.0)
        inner = dense(first, weights[1], biases[1])
        hidden = dense(state, weights[2], biases[2])
        for unit in range(_UNITS):
            kept, new = _UNITS + unit, 2 * _UNITS + unit
            reset = 1.0 / (1.0 + exponential(-inner[unit] - hidden[unit]))
            update = 1.0 / (1.0 + exponential(-inner[kept] - hidden[kept]))
            doubled = exponential(2.0 * (reset * hidden[new] + inner[new]))
            state[unit] = update * state[unit] + (1.0 - update) * (1.0 - 2.0 / (doubled + 1.0))
        actions[row] = dense(state, weights[3], biases[3])
