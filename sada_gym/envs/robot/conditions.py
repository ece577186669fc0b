"""The physical conditions in which a robot drives: what the adversary sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.envs.checks import check_number
from sada_gym.parameters import Parameter, ParameterSpace

PARAMETERS = ParameterSpace(
    Parameter("floor_friction", 0.05, 0.45),
    Parameter("payload_kg", 0.0, 5.0, "kg"),
    Parameter("payload_offset_m", -0.1, 0.1, "m"),
    Parameter("lidar_yaw_deg", -30.0, 30.0, "deg"),
    Parameter("lidar_offset_m", -0.15, 0.15, "m"),
    Parameter("lidar_noise_m", 0.0, 0.2, "m"),
    Parameter("lidar_dropout", 0.0, 0.9),
    Parameter("wheel_gain", -0.18, 0.18),
    Parameter("obstacle_density", 0.0, 2.0, "1/10 m²"),
    Parameter("latency_s", 0.0, 0.6, "s"),
)

_BARRELS_PER_DENSITY = 8


@dataclass(frozen=True)
class Conditions:
    """The conditions of one trip; the defaults are the middles of their ranges.

    Attributes:
        floor_friction: Between wheels and floor.
        payload_kg: What the robot carries.
        payload_offset_m: How far before the axle the payload lies.
        lidar_yaw_deg: By how much the lidar is turned to the left.
        lidar_offset_m: How far to the left of the robot's middle the lidar sits.
        lidar_noise_m: The standard deviation of each range.
        lidar_dropout: The share of rays that return nothing.
        wheel_gain: The right wheel turns faster by this share than commanded, the left one slower.
        obstacle_density: Barrels on 10 m² of the hall that are not on the map.
        latency_s: How long a command takes to reach the motors.
    """

    floor_friction: float = 0.25
    payload_kg: float = 2.5
    payload_offset_m: float = 0.0
    lidar_yaw_deg: float = 0.0
    lidar_offset_m: float = 0.0
    lidar_noise_m: float = 0.1
    lidar_dropout: float = 0.45
    wheel_gain: float = 0.0
    obstacle_density: float = 1.0
    latency_s: float = 0.3

    def __post_init__(self) -> None:
        """Refuse conditions outside of their ranges."""
        for parameter in PARAMETERS.parameters:
            check_number(
                parameter.name, getattr(self, parameter.name), parameter.low, parameter.high
            )

    @property
    def barrels(self) -> int:
        """The number of barrels."""
        return round(self.obstacle_density * _BARRELS_PER_DENSITY)


NOMINAL = Conditions()


def conditions(mu: npt.NDArray[np.float32]) -> Conditions:
    """Give the conditions of one mu, (10,)."""
    return Conditions(*PARAMETERS.physical(mu).tolist())
