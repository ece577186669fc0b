"""How a trip of the robot begins, in training too, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from sada_gym.envs.checks import bounded, check_bounds, check_kind
from sada_gym.envs.robot.conditions import NOMINAL, PARAMETERS, Conditions, conditions
from sada_gym.envs.robot.world.floor_plan import TRIPS, FloorPlan, floor_plan

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
