"""What happens in a race at every step, for many drones at once.

Scalar loops compiled by numba: what becomes of a drone never depends on the others in the batch.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sada_gym.compiled import kernel
from sada_gym.envs.uav.world.drone import GRAVITY_M_S2, MASS_KG, SIMULATION_HZ, heading_of, rotation
from sada_gym.envs.uav.world.gates import OPENING_HEIGHT_M, OPENING_WIDTH_M
from sada_gym.envs.uav.world.guidance import TOP_SPEED_M_S, TOP_TURN_RAD_S
from sada_gym.envs.uav.world.physics import FRAMES, REACH_M
from sada_gym.envs.uav.world.track import to_frame

UNIT_M, UNIT_RAD_S = 20.0, 10.0
"""The distance and the turning rate that are observed as 1."""
WORLD_M, CEILING_M = 80.0, 15.0
"""A drone further from the middle, or higher, is lost."""
FALLEN_M = 0.5
"""A drone that is lower and upside down is lost."""

Array = npt.NDArray[np.float64]

_MOST_WINDUP_RAD = 0.3
_TOUCH_M_S = 1e-6


@kernel
def observed_gates(waypoints: Array) -> npt.NDArray[np.float32]:
    """Give waypoints (n, 4) as observed: place over `UNIT_M`, cosine and sine of the heading."""
    found = np.empty((len(waypoints), 5), np.float32)
    for i in range(len(waypoints)):
        for k in range(3):
            found[i, k] = min(max(waypoints[i, k] / UNIT_M, -1.0), 1.0)
        found[i, 3], found[i, 4] = math.cos(waypoints[i, 3]), math.sin(waypoints[i, 3])
    return found


@kernel
def observed_motion(states: Array) -> npt.NDArray[np.float32]:
    """Give velocity in the level frame, the world's up in the body's frame, and body rates."""
    found = np.empty((len(states), 9))
    for i in range(len(states)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        cosine, sine = math.cos(heading), math.sin(heading)
        r = rotation(s[3], s[4], s[5], s[6])
        found[i, 0] = (s[7] * cosine + s[8] * sine) / TOP_SPEED_M_S
        found[i, 1] = (s[8] * cosine - s[7] * sine) / TOP_SPEED_M_S
        found[i, 2] = s[9] / TOP_SPEED_M_S
        for k in range(3):
            found[i, 3 + k] = r[2, k]
            found[i, 6 + k] = (r[0, k] * s[10] + r[1, k] * s[11] + r[2, k] * s[12]) / UNIT_RAD_S
        for k in range(9):
            found[i, k] = min(max(found[i, k], -1.0), 1.0)
    return found.astype(np.float32)


@kernel
def frames_near(gates: Array, states: Array) -> npt.NDArray[np.int64]:
    """Give the frames that a drone could touch soon, nearest first: (n, FRAMES), -1 for none."""
    near = np.full((len(states), FRAMES), -1)
    least = np.empty(FRAMES)
    for i in range(len(states)):
        least[:] = REACH_M
        for k in range(gates.shape[1]):
            away = to_frame(gates[i, k], states[i, 0], states[i, 1])
            at = FRAMES
            while at > 0 and away < least[at - 1]:
                at -= 1
            if at < FRAMES:
                for m in range(FRAMES - 1, at, -1):
                    near[i, m], least[m] = near[i, m - 1], least[m - 1]
                near[i, at], least[at] = k, away
    return near


@kernel
def orders(actions: Array, states: Array, headings: Array) -> tuple[Array, Array]:
    """Turn actions into the flight controller's commands and the headings that it starts from."""
    commands, begun = np.empty((len(actions), 4)), np.empty(len(actions))
    for i in range(len(actions)):
        s = states[i]
        heading = heading_of(s[3], s[4], s[5], s[6])
        forward, left = actions[i, 0], actions[i, 1]
        over = max(math.hypot(forward, left), 1.0)
        forward, left = forward / over * TOP_SPEED_M_S, left / over * TOP_SPEED_M_S
        cosine, sine = math.cos(heading), math.sin(heading)
        commands[i, 0] = forward * cosine - left * sine
        commands[i, 1] = forward * sine + left * cosine
        commands[i, 2] = actions[i, 2] * TOP_SPEED_M_S
        commands[i, 3] = actions[i, 3] * TOP_TURN_RAD_S
        behind = (headings[i] - heading + math.pi) % (2 * math.pi) - math.pi
        begun[i] = heading + min(max(behind, -_MOST_WINDUP_RAD), _MOST_WINDUP_RAD)
    return commands, begun


@kernel
def judge(
    before: Array,
    after: Array,
    wrenches: Array,
    gates: Array,
    next_gate: npt.NDArray[np.intp],
    endings: npt.NDArray[np.int8],
    touched: npt.NDArray[np.bool_],
    time_s: Array,
    since: npt.NDArray[np.int64],
) -> None:
    """See which gates were passed in one step of the simulation, and what was touched."""
    for i in range(len(before)):
        k = next_gate[i]
        if k == gates.shape[1]:
            continue
        time_s[i] += 1 / SIMULATION_HZ
        since[i] += 1
        for axis in range(3):
            pull = wrenches[i, axis] / MASS_KG - (GRAVITY_M_S2 if axis == 2 else 0.0)
            free = before[i, 7 + axis] + pull / SIMULATION_HZ
            if abs(after[i, 7 + axis] - free) > _TOUCH_M_S:
                touched[i, k] = True
        g = gates[i, k]
        cosine, sine = math.cos(g[3]), math.sin(g[3])
        was = (before[i, 0] - g[0]) * cosine + (before[i, 1] - g[1]) * sine
        now = (after[i, 0] - g[0]) * cosine + (after[i, 1] - g[1]) * sine
        if not was < 0.0 <= now:
            continue
        share = was / (was - now)
        x = before[i, 0] + share * (after[i, 0] - before[i, 0]) - g[0]
        y = before[i, 1] + share * (after[i, 1] - before[i, 1]) - g[1]
        z = before[i, 2] + share * (after[i, 2] - before[i, 2]) - g[2]
        if abs(y * cosine - x * sine) <= OPENING_WIDTH_M / 2 and abs(z) <= OPENING_HEIGHT_M / 2:
            endings[i, k] = 1
            next_gate[i] = k + 1
            since[i] = 0


@kernel
def lost_ones(states: Array) -> npt.NDArray[np.bool_]:
    """Say which drones are on their backs, out of the world or no finite numbers."""
    lost = np.empty(len(states), np.bool_)
    for i in range(len(states)):
        s = states[i]
        at_home = abs(s[0]) < WORLD_M and abs(s[1]) < WORLD_M and -1.0 < s[2] < CEILING_M
        fallen = s[2] < FALLEN_M and rotation(s[3], s[4], s[5], s[6])[2, 2] < 0.0
        sane = True
        for k in range(7, 13):
            sane = sane and math.isfinite(s[k])
        lost[i] = fallen or not (at_home and sane)
    return lost
