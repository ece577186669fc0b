"""The autopilot of the aircraft's own files: it flies inside JSBSim, once it is switched on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sada_gym.envs.flight.episodes import FlightEpisodes
from sada_gym.foundations.arrays import Floats, Indices


class BuiltIn:
    """Switches the autopilot on, and touches nothing afterwards."""

    def __init__(self, fingerprint: str) -> None:
        self.fingerprint = fingerprint

    def start(self, count: int) -> None:
        """Begin `count` new flights."""

    def act(self, episodes: FlightEpisodes, which: Indices) -> Floats:
        """Return actions (n, 4) that change nothing."""
        episodes.engage(which[episodes.steps[which] == 0])
        return np.zeros((len(which), 4))


def load(files: Mapping[str, Path]) -> BuiltIn:
    """Name the autopilots by the files of the installed package on which flights depend."""
    parts = [name.encode() + files[name].read_bytes() for name in sorted(files)]
    return BuiltIn(hashlib.sha256(b"".join(parts)).hexdigest())
