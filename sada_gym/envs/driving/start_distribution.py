"""What a driver is trained on: random routes, weathers, camera mounts and starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sada_gym.envs.checks import bounded, check_bounds
from sada_gym.envs.driving.camera.pinhole import Mount
from sada_gym.envs.driving.episodes import TOP_SPEED_M_S, DrivingStart
from sada_gym.envs.driving.world.layout import LAYOUTS
from sada_gym.envs.driving.world.route import random_route
from sada_gym.envs.driving.world.town import LANE_WIDTH_M, town
from sada_gym.envs.driving.world.weather import NAMES, TRAINING_WEATHERS, weather_index
from sada_gym.errors import UserError


@dataclass(frozen=True)
class StartDistribution:
    """A distribution of drives.

    Attributes:
        layout: The town, `training` or `benchmark`.
        weathers: The names of the weathers that occur.
        height_m: The least and the greatest height of the camera.
        pitch_deg: The least and the greatest pitch of the camera.
        corners: The least and the greatest number of corners and bends that a route passes.
        lateral_m: The greatest distance from its lane's middle at which a car starts.
        turned_deg: The greatest angle by which the car is turned.
        speed_m_s: The greatest speed at which the car starts.
    """

    layout: str = "training"
    weathers: tuple[str, ...] = NAMES[:TRAINING_WEATHERS]
    height_m: tuple[float, float] = bounded(0.5, 5.0, (1.4, 1.4))
    pitch_deg: tuple[float, float] = bounded(-25.0, 25.0, (-15.0, -15.0))
    corners: tuple[int, int] = bounded(1, 20, (1, 4))
    lateral_m: float = bounded(0.0, LANE_WIDTH_M / 2, 0.0)
    turned_deg: float = bounded(0.0, 90.0, 0.0)
    speed_m_s: float = bounded(0.0, TOP_SPEED_M_S, 0.0)

    def __post_init__(self) -> None:
        """Reject unknown names, and cameras from which no image can be drawn."""
        if self.layout not in LAYOUTS:
            raise UserError(f"Expected a layout among {', '.join(LAYOUTS)}, got {self.layout!r}.")
        if isinstance(self.weathers, str) or not self.weathers:
            raise UserError(f"Expected a tuple of weathers' names, got {self.weathers!r}.")
        for name in self.weathers:
            weather_index(name)
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> DrivingStart:
        """Draw one drive."""
        corners = int(rng.integers(self.corners[0], self.corners[1] + 1))
        route = random_route(town(self.layout), rng, corners)
        mount = Mount(float(rng.uniform(*self.height_m)), float(rng.uniform(*self.pitch_deg)))
        return DrivingStart(
            route=route,
            mount=mount,
            weather=weather_index(self.weathers[rng.integers(len(self.weathers))]),
            seed=int(rng.integers(2**31)),
            lateral_m=float(rng.uniform(-self.lateral_m, self.lateral_m)),
            turned_rad=float(np.deg2rad(rng.uniform(-self.turned_deg, self.turned_deg))),
            speed_m_s=float(rng.uniform(0, self.speed_m_s)),
        )
