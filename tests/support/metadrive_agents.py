"""Agents for tests of MetaDrive whose drives are short."""

import numpy as np


class Swerver:
    """Drives off its road within some seconds; where depends on what it sees."""

    fingerprint = "swerver"

    def start(self, count):
        pass

    def act(self, episodes, which):
        seen = episodes.observe(which)
        steering = 0.15 + 0.1 * seen["lidar"][:, ::10].mean(axis=1) - 0.2 * seen["state"][:, 4]
        return np.stack([steering, np.ones(len(which))], axis=1).astype(np.float64)
