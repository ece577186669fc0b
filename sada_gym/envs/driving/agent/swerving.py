"""A driver that leaves its lane at once, for tests in which the driver is not what counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.driving.episodes import ACTION_SPACE, OBSERVATION_SPACE


class Swerving:
    """A driver that steers to the right with full throttle."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE

    def predict(
        self,
        observation: dict[str, npt.NDArray[Any]],
        *,
        deterministic: bool,  # noqa: ARG002 - as SB3's models have it
    ) -> tuple[npt.NDArray[np.float32], None]:
        """Give the actions for n observations: (n, 2)."""
        return np.ones((len(observation["speed"]), 2), np.float32), None
