"""Guidance: from a waypoint to the command of the flight controller.

A waypoint is the next gate as a pilot has it, in the drone's level frame (x to its heading, y left,
z up): x, y, z of the opening's centre in m, and the heading in which to pass it in rad.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.uav.world.drone import heading_of
from sada_gym.envs.uav.world.gates import OUTER_WIDTH_M
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.compiled import kernel

TOP_SPEED_M_S = 16.0
"""The velocity that a command of 1 means, forward, to the left, or up."""
TOP_TURN_RAD_S = 4.0
"""The turning rate that a command of 1 means, to the left."""
SPEED_M_S = 11.5
"""The speed at which a pilot with a camera is guided."""
LEAD = 0.25
"""A drone aims before the gate by this share of the distance, so as to come in along its axis."""
TURN_GAIN_PER_S = 4.0
CLIMB_GAIN_PER_S = 2.0
LOOK_M = 1.5
"""A drone that is nearer to the gate turns to the gate's heading and not to its centre."""
BACK_M = 3.0
"""A drone that flew beside a gate flies back to a place so far before the gate."""


@kernel
def waypoints(gates: Floats, states: Floats) -> Floats:
    """Return the true waypoints, (n, 4): gates (n, 4) in the level frames of drones (n, 13)."""
    seen = np.empty((len(states), 4))
    for i in range(len(states)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        cosine, sine = math.cos(heading), math.sin(heading)
        dx, dy = gates[i, 0] - s[0], gates[i, 1] - s[1]
        seen[i, 0] = dx * cosine + dy * sine
        seen[i, 1] = -dx * sine + dy * cosine
        seen[i, 2] = gates[i, 2] - s[2]
        seen[i, 3] = _wrapped(gates[i, 3] - heading)
    return seen


@kernel
def steer(waypoints: Floats, speed_m_s: float) -> Floats:
    """Fly to waypoints (n, 4) at a speed over the ground.

    Returns:
        Actions, (n, 4) in [-1, 1]: wanted velocity forward, to the left and up over
        `TOP_SPEED_M_S`, and turning rate over `TOP_TURN_RAD_S`.
    """
    actions = np.empty((len(waypoints), 4))
    for i in range(len(waypoints)):
        x, y, z, turn = waypoints[i]
        ux, uy = math.cos(turn), math.sin(turn)
        ahead = x * ux + y * uy
        side = -x * uy + y * ux
        far = math.hypot(x, y)
        lead = LEAD * far
        aim_x, aim_y = x - lead * ux, y - lead * uy
        if ahead < 0.0:  # past it: fly back beside the frame
            beside = math.copysign(OUTER_WIDTH_M, -side)
            aim_x = x - BACK_M * ux - beside * uy
            aim_y = y - BACK_M * uy + beside * ux
        size = max(math.hypot(aim_x, aim_y), 1e-6)
        actions[i, 0] = speed_m_s * aim_x / size / TOP_SPEED_M_S
        actions[i, 1] = speed_m_s * aim_y / size / TOP_SPEED_M_S
        actions[i, 2] = min(max(CLIMB_GAIN_PER_S * z / TOP_SPEED_M_S, -1.0), 1.0)
        wanted = turn if far < LOOK_M else math.atan2(y, x)
        actions[i, 3] = min(max(TURN_GAIN_PER_S * wanted / TOP_TURN_RAD_S, -1.0), 1.0)
    return actions


@kernel
def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi
