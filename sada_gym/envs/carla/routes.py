"""Five routes of a task through a town, found on CARLA's map by following its lanes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from sada_gym.errors import UserError, check_known
from sada_gym.foundations.arrays import Floats

COMMANDS = ("follow", "left", "right", "straight")
"""What a driver is told at junctions, in the order of the observation's `command`."""
ROUTES = 5
STEP_M = 2.0
_TOLD_BEFORE_M = 20.0  # the command of a junction begins so far ahead
_BEHIND_JUNCTION_M = 20.0
_MAX_JUNCTION_M = 80.0
_MAX_M = 1_000.0
_STRAIGHT_DEG = 35.0
_TURNS = ("left", "right")
_PLANS: dict[str, tuple[tuple[str, ...], ...]] = {
    "straight": (("straight",),),
    "one_curve": tuple((turn,) for turn in _TURNS),
    "navigation": (*product(_TURNS, ("straight",), _TURNS), *product(_TURNS, _TURNS)),
}
"""What a route does at its junctions, in the order of preference."""
TASKS = tuple(_PLANS)


@dataclass(frozen=True)
class TownRoute:
    """A way along lanes, in CARLA's coordinates.

    Attributes:
        points_m: (n, 2) x and y of points `STEP_M` apart.
        commands: (n,) what the driver is told there, an index into `COMMANDS`.
        start: x, y, z in m and the yaw in degrees at which a car begins.
    """

    points_m: Floats
    commands: tuple[int, ...]
    start: tuple[float, float, float, float]

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return STEP_M * (len(self.points_m) - 1)


def find_routes(town_map: Any, task: str) -> tuple[TownRoute, ...]:
    """Find the five routes of a task, always the same on the same `carla.Map`.

    `straight` crosses one junction, `one_curve` turns at one, and `navigation` turns at two or
    goes straight on at one between them.

    Raises:
        UserError: If there is no such task, or the town has fewer routes.
    """
    check_known("task", [task], TASKS)
    routes: list[TownRoute] = []
    for i, start in enumerate(_starts(town_map)):
        plans = _PLANS[task]
        turned = i % len(plans)
        ways = (_follow(start, plan) for plan in (*plans[turned:], *plans[:turned]))
        found = next((way for way in ways if way), None)
        if found:
            routes.append(found)
        if len(routes) == ROUTES:
            return tuple(routes)
    raise UserError(
        f"Expected {ROUTES} routes for task={task!r} in {town_map.name}, found {len(routes)}. "
        "Choose another town or task."
    )


def _starts(town_map: Any) -> Iterator[Any]:
    """Yield where routes may start, spread over the town; maps without spawn points have lanes."""
    places = town_map.get_spawn_points()
    waypoints = [town_map.get_waypoint(place.location) for place in places]
    waypoints = waypoints or town_map.generate_waypoints(25.0)
    apart = max(1, len(waypoints) // (4 * ROUTES))
    for first in range(apart):
        yield from (at for at in waypoints[first::apart] if not at.is_junction)


def _follow(start: Any, plan: Sequence[str]) -> TownRoute | None:
    """Return the way from a waypoint that does at its junctions as planned; None if there is none.

    It ends some metres behind the last junction.
    """
    way, commands = [start], [0]
    left_m, plan = 0.0, list(plan)
    while len(way) * STEP_M < _MAX_M:
        ahead = way[-1].next(STEP_M)
        if not ahead:
            return None
        chosen, command = ahead[0], 0
        if chosen.is_junction and not way[-1].is_junction:
            too_near = len(way) * STEP_M < _TOLD_BEFORE_M
            if not plan or too_near:
                return None
            command = COMMANDS.index(plan.pop(0))
            options = [option for option in ahead if _turn(way[-1], option) == COMMANDS[command]]
            if not options:
                return None
            chosen = options[0]
            told = int(_TOLD_BEFORE_M / STEP_M)
            commands[-told:] = [command] * len(commands[-told:])
        elif chosen.is_junction:
            command = commands[-1]
        way.append(chosen)
        commands.append(command)
        left_m = 0.0 if chosen.is_junction or plan else left_m + STEP_M
        if left_m >= _BEHIND_JUNCTION_M:
            break
    else:
        return None
    points = np.array([[at.transform.location.x, at.transform.location.y] for at in way])
    place, yaw = start.transform.location, start.transform.rotation.yaw
    return TownRoute(points, tuple(commands), (place.x, place.y, place.z, yaw))


def _turn(before: Any, entry: Any) -> str:
    """Return what the way through a junction does: a yaw in CARLA grows to the right."""
    after = entry
    for _ in range(int(_MAX_JUNCTION_M / STEP_M)):
        ahead = after.next(STEP_M)
        if not after.is_junction or not ahead:
            break
        after = ahead[0]
    turned = after.transform.rotation.yaw - before.transform.rotation.yaw
    turned = (turned + 180.0) % 360.0 - 180.0
    return "straight" if abs(turned) < _STRAIGHT_DEG else "right" if turned > 0 else "left"
