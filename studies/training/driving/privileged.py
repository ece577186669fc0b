"""The privileged driver, which knows its route and its place on it: pure pursuit, a speed profile.

It is the expert that drivers imitate, and shows that a route can be driven.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sada_gym.envs.driving.episodes import POLICY_HZ, DrivingEpisodes
from sada_gym.envs.driving.world.route import CRUISE_M_S, SPACING_M, Route
from sada_gym.envs.driving.world.vehicle import LENGTH_M, MAX_ACCELERATION_M_S2, MAX_STEERING_RAD

SIDEWAYS_M_S2 = 2.5
"""The sideways acceleration that it allows itself in a curve."""
BRAKING_M_S2 = 2.5
"""The deceleration with which it slows down before a curve."""

Array = npt.NDArray[np.float64]


class PrivilegedDriver:
    """Drives cars along their routes (pure pursuit, Coulter 1992)."""

    fingerprint = "privileged driver"

    def __init__(self) -> None:
        self._profiles: dict[int, tuple[Route, Array]] = {}

    def start(self, count: int) -> None:
        """Begin new drives; nothing is remembered of others."""

    def act(self, drives: DrivingEpisodes, which: npt.NDArray[np.intp]) -> Array:
        """Choose actions (n, 2) for some cars."""
        actions = np.empty((len(which), 2))
        for row, i in enumerate(which):
            route = drives.starts[i].route
            actions[row] = self._choose(route, drives.states[i], drives.progress_m[i])
        return actions

    def _choose(self, route: Route, state: Array, progress_m: float) -> tuple[float, float]:
        x, y, heading, speed = state
        ahead = np.clip(0.6 * speed, 3.0, 6.0)
        goal = _beyond(route, progress_m + ahead)
        dx, dy = goal - (x, y)
        right = -np.sin(heading) * dx + np.cos(heading) * dy
        curvature = 2 * right / max(dx * dx + dy * dy, 1.0)
        slip = np.arcsin(np.clip(curvature * LENGTH_M / 2, -0.95, 0.95))
        steering = np.arctan(2 * np.tan(slip)) / MAX_STEERING_RAD
        wanted = self._speed(route, progress_m + speed / POLICY_HZ)
        acceleration = (wanted - speed) * 2.0 / MAX_ACCELERATION_M_S2
        return np.clip(steering, -1, 1), np.clip(acceleration, -1, 0.6)

    def _speed(self, route: Route, progress_m: float) -> float:
        known = self._profiles.get(id(route))
        if known is None or known[0] is not route:
            known = self._profiles[id(route)] = (route, speed_profile(route))
        index = int(np.clip(progress_m / SPACING_M, 0, len(route.points) - 1))
        return float(known[1][index])


def speed_profile(route: Route) -> Array:
    """Return how fast to drive at each point: slow enough for the curves ahead."""
    curvature = np.abs(np.gradient(route.heading, SPACING_M))
    speed = np.minimum(CRUISE_M_S, np.sqrt(SIDEWAYS_M_S2 / np.maximum(curvature, 1e-6)))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2 * BRAKING_M_S2 * SPACING_M))
    return speed


def _beyond(route: Route, along_m: float) -> Array:
    """Return the route's point at a distance; past its end, the way goes straight on."""
    end = SPACING_M * (len(route.points) - 1)
    index = int(np.clip(along_m / SPACING_M, 0, len(route.points) - 1))
    past = max(0.0, along_m - end)
    heading = route.heading[index]
    place: Array = route.points[index] + past * np.array([np.cos(heading), np.sin(heading)])
    return place
