"""How a flight begins: the platform, the conditions that the adversary sets, and the seed.

The platforms are two of those that RAPTOR's authors fly, with the figures of their simulator,
`l2f` 2.0.18 (`parameters/dynamics/crazyflie.h` and `x500_real.h`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from sada_gym.errors import check_known
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Parameter, ParameterSpace

POLICY_HZ = 100
"""RAPTOR was trained at this rate."""
GRAVITY_M_S2 = 9.81
MOTORS = ((1.0, -1.0, -1.0), (-1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, 1.0, 1.0))
"""Each motor's sides, x ahead and y to the left, and the sign of its torque about z. RAPTOR numbers
them so: front right, back right, back left, front left."""
START_M, START_TILT = 0.3, 0.17364817766693033
"""A seed moves a quadrotor from the reference by at most this along each axis, and tilts it about x
and about y: the second is the sine of half of 20 degrees, the mildest of the authors' trainings."""
DRAG_PER_S = 0.3
"""Drag over mass and airspeed, about what Faessler, Franchi and Scaramuzza (2018) measured."""

PARAMETERS = ParameterSpace(
    Parameter("mass_ratio", 0.7, 1.5),
    Parameter("arm_ratio", 0.77, 1.3),
    Parameter("thrust_to_weight", 1.5, 5.0),
    Parameter("torque_to_inertia", 40.0, 1200.0, unit="1/s²"),
    Parameter("spin_up_s", 0.03, 0.10, unit="s"),
    Parameter("spin_down_s", 0.03, 0.30, unit="s"),
    Parameter("load_ahead", -0.1, 0.1, unit="arms"),
    Parameter("load_left", -0.1, 0.1, unit="arms"),
    Parameter("weak_motor", 0.0, 0.2),
    Parameter("wind_m_s", 0.0, 5.0, unit="m/s"),
    Parameter("gust_m_s", 0.0, 2.0, unit="m/s"),
    Parameter("noise_m", 0.0, 0.02, unit="m"),
    Parameter("delay_s", 0.0, 0.01, unit="s"),
    Parameter("speed_m_s", 0.0, 2.0, unit="m/s"),
)


class FlightEnd(IntEnum):
    """How a flight ended."""

    UNDER_WAY = 0
    FLOWN = 1
    CRASHED = 2
    LOST = 3


class Platform(NamedTuple):
    """A quadrotor as it is built: x, y and z are ahead, to the left and up."""

    title: str
    mass_kg: float
    arm_m: float  # a motor's distance from the middle, along x as along y
    thrust_curve: tuple[float, float, float]  # a polynomial of the throttle
    torque_per_thrust_m: float
    inertia_y: float  # the moments of inertia about y and z, as multiples of that about x
    inertia_z: float


# x500_real.h has 2.1705-2 for the inertia about x, a slip: its inverse is that of 2.1705e-2
PLATFORMS = {
    "crazyflie": Platform(
        *("Crazyflie", 0.0306, 0.028, (0.00352526, 0.01437313, 0.09223048), 4.665e-3),
        *(1.0242, 1.8541),
    ),
    "x500": Platform(
        *("X500", 2.0, 0.17677669529663687, (0.0, 0.0, 15.926119900619797), 0.10847),
        *(0.9815, 1.8151),
    ),
}


@dataclass(frozen=True)
class QuadrotorStart:
    """How one flight begins."""

    platform: str
    conditions: dict[str, float]  # the physical values of all parameters
    seed: int  # fixes place, tilt, gusts and noise

    def __post_init__(self) -> None:
        """Check the platform."""
        check_known("platform", [self.platform], [*PLATFORMS])

    def place(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draw the offset from the reference in m, (3,), and the attitude, a quaternion wxyz."""
        offset, (x, y) = rng.uniform(-START_M, START_M, 3), rng.uniform(-START_TILT, START_TILT, 2)
        return offset, np.array([math.sqrt(1.0 - x * x - y * y), x, y, 0.0])

    @property
    def hover(self) -> float:
        """The throttle at which motors of equal strength carry the weight."""
        c0, c1, c2 = PLATFORMS[self.platform].thrust_curve
        needed = (c0 + c1 + c2) / self.conditions["thrust_to_weight"]
        return (math.sqrt(c1 * c1 + 4.0 * c2 * (needed - c0)) - c1) / (2.0 * c2)

    def airframe(self) -> tuple[Floats, Floats]:
        """Return the body, (7,), and the motors, (24,), as `dynamics.fly` takes them."""
        built, now = PLATFORMS[self.platform], self.conditions
        mass, arm = built.mass_kg * now["mass_ratio"], built.arm_m * now["arm_ratio"]
        most = now["thrust_to_weight"] * mass * GRAVITY_M_S2 / 4
        inertia = math.sqrt(2.0) * arm * most / now["torque_to_inertia"]
        motors = np.zeros((4, 6))
        motors[:, :3] = MOTORS
        motors[:, :2] = arm * (motors[:, :2] - [now["load_ahead"], now["load_left"]])
        motors[:, 2] *= built.torque_per_thrust_m
        motors[:, 3:] = np.array(built.thrust_curve) * (most / sum(built.thrust_curve))
        motors[0, 3:] *= 1.0 - now["weak_motor"]
        body = [mass, inertia, inertia * built.inertia_y, inertia * built.inertia_z]
        drag = DRAG_PER_S / now["mass_ratio"]
        return np.array([*body, now["spin_up_s"], now["spin_down_s"], drag]), motors.ravel()
