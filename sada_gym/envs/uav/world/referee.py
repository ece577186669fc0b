"""What happens in a race at every step, and what a drone touches, for many drones at once.

Touch is geometry: the drone's box against the bars of gates and the ground. Scalar loops compiled
by numba: what becomes of a drone never depends on the others in the batch.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from sada_gym.envs.uav.world.drone import SIMULATION_HZ, heading_of, rotation
from sada_gym.envs.uav.world.gates import (
    BARS,
    DEPTH_M,
    OPENING_HEIGHT_M,
    OPENING_WIDTH_M,
    OUTER_WIDTH_M,
)
from sada_gym.envs.uav.world.guidance import TOP_SPEED_M_S, TOP_TURN_RAD_S
from sada_gym.foundations.arrays import Floats, Floats32, Indices, Integers
from sada_gym.foundations.compiled import kernel

BODY_M = (0.24, 0.20, 0.06)
"""The size of the drone's box: forward, to the left, up."""


_HALF = np.array(BODY_M) / 2
_RADIUS_M = math.sqrt(float((_HALF**2).sum()))
_FAR_M = math.hypot(OUTER_WIDTH_M / 2, DEPTH_M / 2) + _RADIUS_M
_ROUNDING = 1e-12
"""Added to each cosine between two boxes, since the cross product of parallel edges is no axis."""


@kernel
def touches(state: Floats, gates: Floats) -> bool:
    """Say whether a drone (13,) touches the ground or a frame of gates (g, 4)."""
    x, y, z = state[0], state[1], state[2]
    r = rotation(state[3], state[4], state[5], state[6])
    reach = 0.0
    for k in range(3):
        reach += abs(r[2, k]) * _HALF[k]
    if z <= reach:
        return True
    for g in range(len(gates)):
        dx, dy = x - gates[g, 0], y - gates[g, 1]
        if dx * dx + dy * dy > _FAR_M * _FAR_M:
            continue
        cosine, sine = math.cos(gates[g, 3]), math.sin(gates[g, 3])
        ahead, left, up = dx * cosine + dy * sine, dy * cosine - dx * sine, z - gates[g, 2]
        if abs(ahead) > DEPTH_M / 2 + _RADIUS_M:
            continue
        own = np.empty((3, 3))  # the drone's axes in the gate's frame
        for k in range(3):
            own[0, k] = r[0, k] * cosine + r[1, k] * sine
            own[1, k] = r[1, k] * cosine - r[0, k] * sine
            own[2, k] = r[2, k]
        for b in range(len(BARS)):
            if _meet(own, ahead, left - BARS[b, 0], up - BARS[b, 1], BARS[b, 2], BARS[b, 3]):
                return True
    return False


@kernel
def _meet(own: Floats, x: float, y: float, z: float, width: float, height: float) -> bool:
    """Say whether the drone's box and a bar have a point in common (separating axes, Gottschalk).

    The columns of `own` (3, 3) are the drone's axes in the bar's frame, and x, y, z its place from
    the bar's middle; `width` and `height` are half the bar's.
    """
    off, bar, size = np.array((x, y, z)), np.array((DEPTH_M / 2, width, height)), np.abs(own)
    size += _ROUNDING
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        if abs(off[i]) > bar[i] + (size[i] * _HALF).sum():
            return False
        if abs((off * own[:, i]).sum()) > _HALF[i] + (bar * size[:, i]).sum():
            return False
        for k in range(3):
            c, d = (k + 1) % 3, (k + 2) % 3
            reach = bar[a] * size[b, k] + bar[b] * size[a, k]
            reach += _HALF[c] * size[i, d] + _HALF[d] * size[i, c]
            if abs(off[b] * own[a, k] - off[a] * own[b, k]) > reach:
                return False
    return True


UNIT_M, UNIT_RAD_S = 20.0, 10.0
"""The distance and the turning rate that are observed as 1."""
WORLD_M, CEILING_M = 80.0, 15.0
"""A drone further from the middle, or higher, is lost."""

Endings = npt.NDArray[np.int8]

_MOST_WINDUP_RAD = 0.3
_MOST = 1_000.0
"""No velocity of a drone is as great."""


class GateOutcome(IntEnum):
    """What became of a gate: passed, or missed in one of three ways."""

    AHEAD = 0
    PASSED = 1
    HIT = 2
    LATE = 3
    LOST = 4


@kernel
def observed_gates(waypoints: Floats) -> Floats32:
    """Return waypoints (n, 4) as observed: place over `UNIT_M`, cosine and sine of the heading."""
    observed = np.empty((len(waypoints), 5), np.float32)
    for i in range(len(waypoints)):
        for k in range(3):
            observed[i, k] = min(max(waypoints[i, k] / UNIT_M, -1.0), 1.0)
        observed[i, 3], observed[i, 4] = math.cos(waypoints[i, 3]), math.sin(waypoints[i, 3])
    return observed


@kernel
def observed_motion(states: Floats) -> Floats32:
    """Return velocity in the level frame, the world's up in the body's frame, and body rates."""
    observed = np.empty((len(states), 9))
    for i in range(len(states)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        cosine, sine = math.cos(heading), math.sin(heading)
        r = rotation(s[3], s[4], s[5], s[6])
        observed[i, 0] = (s[7] * cosine + s[8] * sine) / TOP_SPEED_M_S
        observed[i, 1] = (s[8] * cosine - s[7] * sine) / TOP_SPEED_M_S
        observed[i, 2] = s[9] / TOP_SPEED_M_S
        for k in range(3):
            observed[i, 3 + k] = r[2, k]
            observed[i, 6 + k] = (r[0, k] * s[10] + r[1, k] * s[11] + r[2, k] * s[12]) / UNIT_RAD_S
        for k in range(9):
            observed[i, k] = min(max(observed[i, k], -1.0), 1.0)
    return observed.astype(np.float32)


@kernel
def orders(
    which: Indices,
    actions: Floats,
    states: Floats,
    next_gate: Indices,
    endings: Endings,
    ended_at: Floats,
    headings: Floats,
    commands: Floats,
) -> None:
    """Turn the actions of some of n drones into commands, or end their gates as lost.

    `which` (m,) are their indices, `actions` (m, 4), `states` (n, 13), `next_gate` (n,). Changed in
    place: `endings` (n, g) and `ended_at` (n, g, 3), where an action or a state is not possible;
    `headings` (n,), from which the flight controller starts, and `commands` (n, 4) to it.
    """
    for row in range(len(which)):
        i = which[row]
        s, action = states[i], actions[row]
        if is_lost(s) or not np.isfinite(action).all():
            endings[i, next_gate[i]] = GateOutcome.LOST
            ended_at[i, next_gate[i]] = s[:3]
            commands[i] = 0.0
            continue
        heading = heading_of(s[3], s[4], s[5], s[6])
        forward, left, up, turn = np.minimum(np.maximum(action, -1.0), 1.0)
        over = max(math.hypot(forward, left), 1.0)
        forward, left = forward / over * TOP_SPEED_M_S, left / over * TOP_SPEED_M_S
        cosine, sine = math.cos(heading), math.sin(heading)
        commands[i, 0] = forward * cosine - left * sine
        commands[i, 1] = forward * sine + left * cosine
        commands[i, 2] = up * TOP_SPEED_M_S
        commands[i, 3] = turn * TOP_TURN_RAD_S
        behind = (headings[i] - heading + math.pi) % (2 * math.pi) - math.pi
        headings[i] = heading + min(max(behind, -_MOST_WINDUP_RAD), _MOST_WINDUP_RAD)


@kernel
def judge(
    which: Indices,
    before: Floats,
    gates: Floats,
    states: Floats,
    next_gate: Indices,
    endings: Endings,
    ended_at: Floats,
    time_s: Floats,
    since: Integers,
    limit: int,
) -> None:
    """Decide what became of the next gates of some of n drones in one step of the simulation.

    `which` are their indices, `before` (n, 3) where they were, `states` (n, 13) as they are now;
    `gates` (n, g, 4); `limit` the steps in which a gate has to be passed. In place change
    `next_gate` (n,) where a gate was passed; `endings` (n, g); `ended_at` (n, g, 3), where the
    drone was when a gate ended; `time_s` (n,); `since` (n,), the steps since the last gate ended.
    A gate that was missed stays the next one, and its drone stays as it is until `RacingEpisodes`
    sets it back.
    """
    for i in which:
        k = next_gate[i]
        if k == gates.shape[1] or endings[i, k] != GateOutcome.AHEAD:
            continue
        time_s[i] += 1 / SIMULATION_HZ
        since[i] += 1
        if is_lost(states[i]):
            endings[i, k] = GateOutcome.LOST
        elif touches(states[i], gates[i]):
            endings[i, k] = GateOutcome.HIT
        elif _passes(before[i], states[i], gates[i, k]):
            endings[i, k] = GateOutcome.PASSED
            next_gate[i], since[i] = k + 1, 0
        elif since[i] >= limit:
            endings[i, k] = GateOutcome.LATE
        if endings[i, k] != GateOutcome.AHEAD:
            ended_at[i, k] = states[i, :3]


@kernel
def _passes(before: Floats, after: Floats, gate: Floats) -> bool:
    cosine, sine = math.cos(gate[3]), math.sin(gate[3])
    was = (before[0] - gate[0]) * cosine + (before[1] - gate[1]) * sine
    now = (after[0] - gate[0]) * cosine + (after[1] - gate[1]) * sine
    if not was < 0.0 <= now:
        return False
    share = was / (was - now)
    x = before[0] + share * (after[0] - before[0]) - gate[0]
    y = before[1] + share * (after[1] - before[1]) - gate[1]
    z = before[2] + share * (after[2] - before[2]) - gate[2]
    left = y * cosine - x * sine
    inside: bool = abs(left) <= OPENING_WIDTH_M / 2 and abs(z) <= OPENING_HEIGHT_M / 2
    return inside


@kernel
def is_lost(state: Floats) -> bool:
    """Say whether a drone (13,) is out of the world, or not in any possible state."""
    x, y, z = state[:3]
    inside = abs(x) < WORLD_M and abs(y) < WORLD_M and -1.0 < z < CEILING_M
    for k in range(3, 13):
        inside = inside and abs(state[k]) < _MOST
    return not inside
