"""Routes: a way through a town, sampled, with the command a driver is given at each point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from highway_env.road.lane import AbstractLane

from sada_gym.envs.driving.world.town import Corner, Manoeuvre, Town, town
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats

COMMANDS: tuple[Manoeuvre, ...] = ("follow", "left", "right", "straight")
SPACING_M = 0.5
"""The distance between two points of a route."""
COMMAND_LEAD_M = 15.0
"""A junction's command begins so far before it."""
CRUISE_M_S = 8.0
"""The speed at which a car should follow a route where nothing makes it slower."""
SLOWEST_MEAN_SPEED_M_S = 10 / 3.6
"""The time limit is what the route takes at 10 km/h, as in CARLA's benchmark."""

LAYOUT = "benchmark"

ROUTES: dict[str, tuple[str, ...]] = {
    "straight": ("A1 B1 C1", "D2 D1 D0", "C3 C2 C1", "C2 B2 A2", "C0 B0 A0"),
    "one_curve": ("A1 B1 B0", "C3 C2 B2", "C2 B2 B1", "E1 D1 D0", "D3 E3 E2"),
    "navigation": (
        "A0 B0 B1 C1 C2",
        "D3 C3 C2 B2 A2",
        "C0 D0 D1 E1 E2",
        "A2 B2 B1 A1 A0",
        "D2 C2 C1 C0 B0",
    ),
}
"""The benchmark's three tasks, five routes each in a town that no driver was trained in, as the
corners that a route comes from, passes and makes for. After CARLA's (Dosovitskiy et al. 2017). Left
and right are balanced: as many turns to either side on `one_curve`, where the fifth route is a
bend, and 6 to 7 on `navigation`."""


@dataclass(frozen=True)
class Route:
    """A way along lanes of a town."""

    # the corner from which the first street comes, the corners passed, and the corner to which the
    # last street leads
    corners: tuple[Corner, ...]
    points: Floats  # (n, 2) the middle of the lane, every `SPACING_M`
    heading: Floats  # (n,) the lanes' heading there, in rad, continuous
    command: npt.NDArray[np.int8]  # (n,) int8, index into `COMMANDS`

    @property
    def length_m(self) -> float:
        """The route's length."""
        return SPACING_M * (len(self.points) - 1)

    @property
    def time_limit_s(self) -> float:
        """The time that a driver may take."""
        return self.length_m / SLOWEST_MEAN_SPEED_M_S


def make_route(
    town: Town, corners: tuple[Corner, ...], *, start: float = 0.1, goal: float = 0.5
) -> Route:
    """Make the route that passes corners[1:-1].

    Args:
        town: The town.
        corners: At least two, each joined to the next by a street.
        start: The share of the first street's lane at which the route begins.
        goal: The share of the last street's lane at which the route ends.

    Raises:
        ValueError: If a street is missing.
    """
    for pair in pairwise(corners):
        if pair not in town.streets:
            neighbours = ", ".join(town.layout.neighbours(pair[0])) or "none"
            raise UserError(
                f"Expected a street from {pair[0]} to {pair[1]}, got none. From {pair[0]} streets "
                f"lead to: {neighbours}."
            )
    lanes: list[AbstractLane] = []
    junctions: list[tuple[float, float, int]] = []
    travelled = 0.0
    for i, pair in enumerate(pairwise(corners)):
        lanes.append(town.streets[pair])
        travelled += lanes[-1].length
        if i < len(corners) - 2:
            passage = town.passages[corners[i], corners[i + 1], corners[i + 2]]
            length = sum(lane.length for lane in passage.lanes)
            command = COMMANDS.index(passage.manoeuvre)
            junctions.append((travelled - COMMAND_LEAD_M, travelled + length, command))
            lanes.extend(passage.lanes)
            travelled += length
    first = start * lanes[0].length
    last = travelled - (1 - goal) * lanes[-1].length
    along = np.arange(first, last, SPACING_M)
    points, heading = _sample(lanes, along)
    commands = np.zeros(len(along), np.int8)
    for begin, end, command in junctions:
        if command:  # a bend has none of its own, and ends no junction's before it
            commands[(along >= begin) & (along < end)] = command
    return Route(corners, points, heading, commands)


@cache
def benchmark_routes(task: str) -> tuple[Route, ...]:
    """Make the five routes of one of the benchmark's tasks; raise `UserError` for no such task."""
    if task not in ROUTES:
        raise UserError(f"Expected a task among {', '.join(ROUTES)}, got {task!r}.")
    ways: list[tuple[Corner, ...]] = [tuple(way.split()) for way in ROUTES[task]]
    return tuple(make_route(town(LAYOUT), way) for way in ways)


def random_route(town: Town, rng: np.random.Generator, corners: int) -> Route:
    """Draw a route that never turns back: it passes `corners` corners or bends."""
    pairs = list(town.streets)
    way = list(pairs[rng.integers(len(pairs))])
    for _ in range(corners):
        onward = [c for c in town.layout.neighbours(way[-1]) if c != way[-2]]
        way.append(onward[rng.integers(len(onward))])
    start, goal = rng.uniform(0.0, 0.6), rng.uniform(0.3, 0.9)
    return make_route(town, tuple(way), start=float(start), goal=float(goal))


def _sample(lanes: list[AbstractLane], along: Floats) -> tuple[Floats, Floats]:
    ends = np.cumsum([lane.length for lane in lanes])
    index = np.minimum(np.searchsorted(ends, along, side="right"), len(lanes) - 1)
    local = along - (ends - [lane.length for lane in lanes])[index]
    points = np.array([lanes[i].position(s, 0.0) for i, s in zip(index, local, strict=True)])
    heading = [lanes[i].heading_at(s) for i, s in zip(index, local, strict=True)]
    return points, np.unwrap(heading)
