"""How a trip of the robot begins, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

from sada_gym.envs.robot.conditions import NOMINAL, Conditions
from sada_gym.envs.robot.world.floor_plan import FloorPlan, floor_plan

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
