"""Where a robot is on its way, and what it observes of the way."""

from __future__ import annotations

import math

from sada_gym.envs.robot.world.geometry import SPACING_M
from sada_gym.envs.robot.world.robot import FORWARD_M_S, TURN_RAD_S
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.compiled import kernel

AHEAD_M = (0.4, 0.8, 1.2, 2.0)
"""A robot observes the points of its way at these distances ahead."""
REST_M = 3.0
"""The rest of the way that is observed as 1; a longer one is observed as 1, too."""
STATES = 2 * len(AHEAD_M) + 8

_BACK, _AHEAD = 5, 15


@kernel
def locate(way: Floats, at: int, pose: Floats) -> tuple[int, float]:
    """Find the point of a way (n, 2) that is nearest to a robot's pose (3,), and what is left.

    The point is looked for near `at`, that of the last call. Returns its index, and the rest in m.
    """
    best, minimum = at, math.inf
    for k in range(max(0, at - _BACK), min(len(way), at + _AHEAD)):
        squared = (way[k, 0] - pose[0]) ** 2 + (way[k, 1] - pose[1]) ** 2
        if squared < minimum:
            best, minimum = k, squared
    k = min(max(best, 1), len(way) - 1)
    dx, dy = way[k, 0] - way[k - 1, 0], way[k, 1] - way[k - 1, 1]
    along = (dx * (pose[0] - way[k, 0]) + dy * (pose[1] - way[k, 1])) / math.sqrt(dx * dx + dy * dy)
    along = min(SPACING_M, max(-SPACING_M, along))
    return best, SPACING_M * (len(way) - 1 - k) - along


@kernel
def fill_state(
    way: Floats,
    at: int,
    pose: Floats,
    velocity: Floats,
    commands: Floats,
    state: Floats32,
) -> None:
    """Fill one row of the observation `state`, (STATES,), see `RobotTaskEnv`.

    The robot is nearest to point `at` of its way (n, 2), at a pose (3,); `velocity` (3,) is that of
    the centre of mass in the hall, and the turning rate; `commands` (k, 2) come newest first.
    """
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(AHEAD_M)):
        point = way[min(len(way) - 1, at + round(AHEAD_M[k] / SPACING_M))]
        dx, dy = point[0] - pose[0], point[1] - pose[1]
        state[2 * k] = (dx * cosine + dy * sine) / AHEAD_M[k]
        state[2 * k + 1] = (-dx * sine + dy * cosine) / AHEAD_M[k]
    k = 2 * len(AHEAD_M)
    state[k] = min(1.0, SPACING_M * (len(way) - 1 - at) / REST_M)
    state[k + 1] = (velocity[0] * cosine + velocity[1] * sine) / FORWARD_M_S
    state[k + 2] = (-velocity[0] * sine + velocity[1] * cosine) / FORWARD_M_S
    state[k + 3] = velocity[2] / TURN_RAD_S
    for j in range(2):
        state[k + 4 + 2 * j] = commands[j, 0]
        state[k + 5 + 2 * j] = commands[j, 1]
