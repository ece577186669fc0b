"""The physical conditions in which a robot drives: what the adversary sets."""

from __future__ import annotations

from dataclasses import dataclass, fields

from sada_gym.envs.checks import bounded, check_bounds
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
