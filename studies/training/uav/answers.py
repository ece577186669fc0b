"""What the perception network should answer: true waypoints in the drone's own frame."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sada_gym.envs.uav.agent.pilot import REACH_M, along, axes_of, level_axes
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel


def in_drone(poses: Floats, waypoints: Floats) -> npt.NDArray[np.float32]:
    """Turn waypoints (n, 4) into what the network should answer, (n, 6)."""
    answers = np.empty((len(poses), 6), np.float32)
    _to_drone(poses, waypoints, answers)
    return answers


@kernel
def _to_drone(poses: Floats, waypoints: Floats, answers: npt.NDArray[np.float32]) -> None:
    level = np.empty((3, 3))
    for i in range(len(poses)):
        own = axes_of(poses[i, 3:7])
        level[:] = own
        level_axes(level)
        cos, sin = math.cos(waypoints[i, 3]), math.sin(waypoints[i, 3])
        for k in range(3):
            x = along(own, k, level[0, 0], level[0, 1], level[0, 2])
            y = along(own, k, level[1, 0], level[1, 1], level[1, 2])
            up = own[k, 2]
            off = x * waypoints[i, 0] + y * waypoints[i, 1] + up * waypoints[i, 2]
            answers[i, k] = off / REACH_M
            answers[i, 3 + k] = x * cos + y * sin
