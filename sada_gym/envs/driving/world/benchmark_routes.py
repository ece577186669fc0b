"""The benchmark's three tasks: five fixed routes each, in a town that no driver was trained in.

After CARLA's tasks (Dosovitskiy et al. 2017). Left and right are balanced: as many turns to either
side on `one_curve`, where the fifth route is a bend, and 6 to 7 on `navigation`.
"""

from __future__ import annotations

from functools import cache

from sada_gym.envs.driving.world.layout import Corner
from sada_gym.envs.driving.world.route import Route, make_route
from sada_gym.envs.driving.world.town import town
from sada_gym.errors import UserError

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
"""The routes of each of the benchmark's tasks, as the corners that a route comes from, passes and
makes for."""


@cache
def benchmark_routes(task: str) -> tuple[Route, ...]:
    """Make the five routes of one of the benchmark's tasks; raise `UserError` for no such task."""
    if task not in ROUTES:
        raise UserError(f"Expected a task among {', '.join(ROUTES)}, got {task!r}.")
    ways: list[tuple[Corner, ...]] = [tuple(way.split()) for way in ROUTES[task]]
    return tuple(make_route(town(LAYOUT), way) for way in ways)
