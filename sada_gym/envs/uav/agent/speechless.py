"""A pilot that misses every gate at once, for tests in which the pilot is not what counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


class Speechless:
    """A pilot without a command: its drones are lost."""

    fingerprint = "speechless"

    def start(self, count: int) -> None:
        """Begin races; nothing is kept."""

    def act(self, races: Any, which: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:  # noqa: ARG002
        """Give no command to the drones `which`: (len(which), 4) NaN."""
        return np.full((len(which), 4), np.nan)
