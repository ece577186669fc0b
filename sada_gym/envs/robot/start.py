"""How a trip of the robot begins: its conditions, which the adversary sets; in training too."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np

from sada_gym.envs.checks import bounded, check_bounds, check_kind
from sada_gym.envs.robot.world.floor_plan import TRIPS, FloorPlan, floor_plan
from sada_gym.foundations.arrays import Floats32
from sada_gym.parameters import Parameter, ParameterSpace

_BARRELS_PER_DENSITY = 8
_UNITS = {"kg": "kg", "m": "m", "deg": "deg", "s": "s", "density": "1/10 m²"}
"""The units of parameters, by the ends of their names."""


@dataclass(frozen=True)
class Conditions:
    """The conditions of one trip; the defaults are the middles of their ranges."""

    floor_friction: float = bounded(0.05, 0.45)
    """The friction between wheels and floor."""
    payload_kg: float = bounded(0.0, 5.0)
    """What the robot carries."""
    payload_offset_m: float = bounded(-0.1, 0.1)
    """How far ahead of the axle the payload lies."""
    lidar_yaw_deg: float = bounded(-30.0, 30.0)
    """The angle by which the lidar is turned to the left."""
    lidar_offset_m: float = bounded(-0.15, 0.15)
    """How far to the left of the robot's middle the lidar sits."""
    lidar_noise_m: float = bounded(0.0, 0.2)
    """The standard deviation of each range."""
    lidar_dropout: float = bounded(0.0, 0.9)
    """The share of rays that return nothing."""
    wheel_gain: float = bounded(-0.18, 0.18)
    """The right wheel turns faster by this share than commanded, the left one slower."""
    obstacle_density: float = bounded(0.0, 2.0)
    """Barrels on 10 m² of the hall that are not on the map."""
    latency_s: float = bounded(0.0, 0.6)
    """The time that a command takes to reach the motors."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_bounds(self)

    @property
    def barrels(self) -> int:
        """The number of barrels."""
        return round(self.obstacle_density * _BARRELS_PER_DENSITY)


NOMINAL = Conditions()


def _parameter(name: str, bounds: tuple[float, float]) -> Parameter:
    return Parameter(name, *bounds, unit=_UNITS.get(name.rpartition("_")[2], ""))


PARAMETERS = ParameterSpace(
    *(_parameter(field.name, field.metadata["bounds"]) for field in fields(Conditions))
)


def conditions(mu: Floats32) -> Conditions:
    """Return the conditions of one mu, (10,)."""
    return Conditions(*PARAMETERS.physical(mu).tolist())


POLICY_HZ = 5
GOAL_M = 0.3
"""The goal is reached where the robot's middle is nearer to it than this."""


class RobotEnd(IntEnum):
    """How a trip ended."""

    UNDER_WAY = 0
    ARRIVED = 1
    COLLIDED = 2
    TOO_LATE = 3


@dataclass(frozen=True)
class RobotStart:
    """How one trip begins."""

    plan: FloorPlan = field(default_factory=lambda: floor_plan(0))
    trip: int = 0  # which of the plan's trips it is
    conditions: Conditions = NOMINAL
    seed: int = 0  # fixes the lidar's noise
    turned_rad: float = 0.0  # by how much the robot is turned from its way to the left


PLANS = 2_000
"""The floor plans of the training have the numbers below this. The benchmark draws its own from
numbers of 63 bits."""


@dataclass(frozen=True)
class TripDistribution:
    """A distribution of trips.

    Attributes:
        conditions: The conditions of all trips, where `spread` is 0.
        spread: Otherwise each condition is drawn from this share of its range, around its middle.
        turned_deg: The greatest angle by which a robot is turned from its way at the start.
    """

    conditions: Conditions = NOMINAL
    spread: float = bounded(0.0, 1.0, 0.0)
    turned_deg: float = bounded(0.0, 180.0, 30.0)

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_kind("conditions", self.conditions, Conditions)
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> RobotStart:
        """Draw one trip."""
        drawn = self.conditions
        if self.spread > 0.0:
            mu = rng.uniform(-self.spread, self.spread, len(PARAMETERS)).astype(np.float32)
            drawn = conditions(mu)
        return RobotStart(
            plan=floor_plan(int(rng.integers(PLANS))),
            trip=int(rng.integers(TRIPS)),
            conditions=drawn,
            seed=int(rng.integers(2**31)),
            turned_rad=float(np.deg2rad(rng.uniform(-self.turned_deg, self.turned_deg))),
        )
