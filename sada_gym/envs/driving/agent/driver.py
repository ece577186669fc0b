"""A driver: a model that gets what the cameras of a batch of cars show."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.agents.policy import Policy
from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.driving.episodes import Drives
from sada_gym.envs.driving.task import ACTION_SPACE, OBSERVATION_SPACE


class Driver:
    """Lets a model drive a batch of cars, deterministically and each as if it were alone.

    Args:
        model: An SB3 model trained on `SADA-DrivingTask-v0`.

    Raises:
        UserError: If its spaces are not the task's.
    """

    def __init__(self, model: Predictor) -> None:
        self._policy = Policy(model, OBSERVATION_SPACE, ACTION_SPACE, "SADA-DrivingTask-v0")

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown."""
        return self._policy.fingerprint

    @property
    def use(self) -> dict[str, Any]:
        """How the model is used, as far as an action depends on it: for `agents.identity`."""
        return self._policy.use

    def start(self, count: int) -> None:
        """Begin new drives of `count` cars."""
        self._policy.start(count)

    def act(self, drives: Drives, which: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
        """Choose actions (n, 2) for some of the cars.

        Raises:
            UserError: If the model gives anything but two finite numbers a car.
        """

        def where(i: int) -> str:
            corners = " ".join(drives.starts[i].route.corners)
            return f"step {drives.steps[i]} of the route {corners}"

        return np.clip(self._policy.act(drives.observe(which), which, where), -1.0, 1.0)
