"""The privileged driver, which knows the whole world and tries out what each command would do.

It shows that a trip can be made: its ways lead around the barrels too, and it knows the robot's
physics, its pending commands, and how carts move.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.robot.episodes import STEP_S, SUBSTEPS, RobotEpisodes
from sada_gym.envs.robot.start import RobotStart
from sada_gym.envs.robot.world.carts import SEES_M, SPEED_M_S
from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M
from sada_gym.envs.robot.world.geometry import (
    CELL_M,
    SPACING_M,
    clearance,
    clearances,
    smooth_way,
    spread_from,
)
from sada_gym.envs.robot.world.robot import RADIUS_M, axle_to_mass, move, rims_of
from sada_gym.envs.robot.world.way import locate
from sada_gym.foundations.arrays import Floats, Indices
from sada_gym.foundations.compiled import kernel

_HALL = np.array(HALL_M)
_LEAST_M, _ROOM_M = 0.25, 0.6
_HORIZON = 45
"""The steps over which a command is tried out once it is in force."""
_PEDALS = (-1.0, 0.0, 0.25, 0.5, 0.75, 1.0)
_WHEELS = (-1.0, -0.6, -0.35, -0.2, -0.1, 0.0, 0.1, 0.2, 0.35, 0.6, 1.0)
COMMANDS = np.array([(pedal, wheel) for pedal in _PEDALS for wheel in _WHEELS])


class PrivilegedDriver:
    """Drives robots; it knows everything about their worlds."""

    fingerprint = "tries out 66 commands"

    def __init__(self) -> None:
        self._known: dict[int, tuple[Floats, Floats]] = {}
        self._at: dict[int, int] = {}

    def start(self, count: int) -> None:  # noqa: ARG002 - as agents have it
        """Begin new trips."""
        self._known, self._at = {}, {}

    def act(self, trips: RobotEpisodes, which: Indices) -> Floats:
        """Choose actions (n, 2) for some robots."""
        actions = np.empty((len(which), 2))
        for row, i in enumerate(which.tolist()):
            start = trips.starts[i]
            if i not in self._known:
                self._known[i], self._at[i] = _way_around(start), 0
            way, standing = self._known[i]
            physics = start.conditions
            self._at[i], best = _best(
                way,
                self._at[i],
                trips.poses[i],
                trips.velocities[i],
                trips.commands[i],
                round(physics.latency_s / STEP_S),
                np.array([physics.payload_kg, physics.payload_offset_m]),
                physics.floor_friction,
                physics.wheel_gain,
                start.plan.racks,
                standing,
                trips.lanes[i],
                trips.places[i],
                COMMANDS,
            )
            actions[row] = COMMANDS[best]
        return actions


def _way_around(start: RobotStart) -> tuple[Floats, Floats]:
    """Plan a trip's way around the barrels too; also give all circles that stand there, (m, 3)."""
    plan = start.plan
    planned = plan.ways[start.trip]
    standing = np.concatenate([plan.pillars, plan.barrels[: start.conditions.barrels]])
    cells = clearances(_HALL, plan.racks, standing)
    columns = round(HALL_M[0] / CELL_M)
    first, last = (
        int(y / CELL_M) * columns + int(x / CELL_M) for x, y in (planned[0], planned[-1])
    )
    cost, before = spread_from(first, _HALL, cells, _LEAST_M, _ROOM_M)
    if not math.isfinite(cost[last]):
        return planned, standing
    return smooth_way(last, before, _HALL, plan.racks, standing), standing


@kernel
def _best(
    way: Floats,
    at: int,
    pose: Floats,
    velocity: Floats,
    commands: Floats,
    delay: int,
    payload: Floats,
    friction: float,
    gain: float,
    racks: Floats,
    circles: Floats,
    lanes: Floats,
    places: Floats,
    choices: Floats,
) -> tuple[int, int]:
    """Return where on its way the robot is, and which command leads furthest and safely.

    Arguments are those of `move`, `velocities` and `drive`, of one robot; `commands` (5, 2) are the
    ones given before, newest first, and `delay` is the latency in steps.
    """
    at, _ = locate(way, at, pose)
    ahead = axle_to_mass(payload[0], payload[1])
    best, lowest = 0, math.inf
    now, rims, carts = np.empty(3), np.empty(2), np.empty_like(places)
    for j in range(len(choices)):
        now[:], carts[:] = velocity, places
        heading = pose[2]
        x, y = pose[0] + ahead * math.cos(heading), pose[1] + ahead * math.sin(heading)
        tight, cost = 1.0, 0.0
        for tick in range(delay + _HORIZON):
            late = -((tick - delay) // SUBSTEPS) - 1
            if late >= 0:
                pedal, wheel = commands[late, 0], commands[late, 1]
            else:
                pedal, wheel = choices[j, 0], choices[j, 1]
            left, right = rims_of(pedal, wheel)
            rims[0], rims[1] = left * (1.0 - gain), right * (1.0 + gain)
            move(now, heading, payload, friction, rims, STEP_S)
            heading += now[2] * STEP_S
            x, y = x + now[0] * STEP_S, y + now[1] * STEP_S
            if tick % 3 != 2:
                continue
            ax, ay = x - ahead * math.cos(heading), y - ahead * math.sin(heading)
            room = clearance(ax, ay, _HALL, racks, circles)
            for k in range(len(lanes)):
                if lanes[k, 0] < 0.0:
                    continue
                dx, dy = lanes[k, 2] - lanes[k, 0], lanes[k, 3] - lanes[k, 1]
                px = lanes[k, 0] + carts[k, 0] * dx - ax
                py = lanes[k, 1] + carts[k, 0] * dy - ay
                gap = math.sqrt(px * px + py * py)
                if gap >= SEES_M:
                    pace = SPEED_M_S * 3 * STEP_S / math.sqrt(dx * dx + dy * dy)
                    carts[k, 0] = min(1.0, max(0.0, carts[k, 0] + carts[k, 1] * pace))
                room = min(room, gap - CART_RADIUS_M)
            tight = min(tight, room - RADIUS_M)
            if tight < 0.01:
                cost = 1_000.0 - tick
                break
        ax, ay = x - ahead * math.cos(heading), y - ahead * math.sin(heading)
        left = math.inf
        for k in range(max(0, at - 3), min(len(way), at + 25)):
            away = math.sqrt((way[k, 0] - ax) ** 2 + (way[k, 1] - ay) ** 2)
            left = min(left, SPACING_M * (len(way) - 1 - k) + 2.0 * away)
        nearest = len(way) - 1
        for k in range(at, min(len(way), at + 25)):  # the heading that leads on from there
            if (way[k, 0] - ax) ** 2 + (way[k, 1] - ay) ** 2 > 0.16 and k > at + 4:
                nearest = k
                break
        wanted = math.atan2(way[nearest, 1] - ay, way[nearest, 0] - ax) - heading
        turned = abs(math.atan2(math.sin(wanted), math.cos(wanted)))
        cost += left + 0.15 * turned + 2.0 * max(0.0, 0.12 - tight)
        if cost < lowest:
            best, lowest = j, cost
    return at, best
