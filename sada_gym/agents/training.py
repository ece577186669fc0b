"""What trainings of drivers and of pilots share."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import safe_mean


def batches(count: int, size: int, rng: np.random.Generator) -> Iterator[npt.NDArray[np.intp]]:
    """Give the indices of an epoch over `count` rows, in a new order, `size` at a time."""
    order = rng.permutation(count)
    for start in range(0, count, size):
        yield order[start : start + size]


class Report(BaseCallback):
    """Says after each rollout how the last episodes went.

    Args:
        success: A word for those that succeeded.
    """

    def __init__(self, success: str) -> None:
        super().__init__()
        self._success = success
        self._started = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        episodes: list[dict[str, Any]] = list(self.model.ep_info_buffer or [])
        print(
            f"{self.num_timesteps:,} steps: reward {safe_mean([e['r'] for e in episodes]):.1f}, "
            f"{self._success} {safe_mean(list(self.model.ep_success_buffer or [])):.2f}, "
            f"{time.process_time() - self._started:.0f} s",
            flush=True,
        )
