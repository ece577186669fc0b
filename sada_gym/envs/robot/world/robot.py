"""A TurtleBot 2: its motors and the grip of its wheels, which decide how its velocity changes.

Kobuki, its base, has two driven wheels of 35 mm radius, 230 mm apart, and a gear of 6545 / 132
(kobuki_driver's documentation, appendix "Kobuki Parameters"). Its motors have a no-load speed of
9,960 rpm within 15 % and a stall torque of 33 mN m at 12 V (Kobuki's documentation, "Anatomy").
The other figures are the usual ones of the platform, and were not checked against a data sheet: a
disc of 351.5 mm with a caster before and one behind the axle, a payload of up to 5 kg, and 6.3 kg
for a whole TurtleBot 2. Where its centre of mass and its inertia lie is assumed.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.foundations.arrays import Floats, Integers
from sada_gym.foundations.compiled import kernel

RADIUS_M = 0.176
MASS_KG = 6.3
INERTIA_KG_M2 = 0.5 * MASS_KG * RADIUS_M**2
"""That of a disc."""
TRACK_M = 0.115
"""From the robot's middle to each wheel."""
CASTER_M = 0.115
"""From the axle to each caster."""
_WHEEL_M = 0.035
_GEAR = 6545 / 132
STALL_N = 0.033 * _GEAR / _WHEEL_M
"""The force of one wheel at the rim when the motor stalls: 47 N."""
TOP_M_S = 9_960 * 2 * math.pi / 60 / _GEAR * _WHEEL_M
"""The speed of the rim at which a motor has no force left: 0.74 m/s."""
GRAVITY_M_S2 = 9.81
FORWARD_M_S, BACKWARD_M_S, TURN_RAD_S = 0.6, 0.1, 1.5
"""The greatest speeds that can be commanded."""


@kernel
def axle_to_mass(payload_kg: float, offset_m: float) -> float:
    """Return how far the centre of mass lies before the axle."""
    return payload_kg * offset_m / (MASS_KG + payload_kg)


@kernel
def move(
    velocity: Floats, heading: float, payload: Floats, friction: float, rims: Floats, dt_s: float
) -> None:
    """Change a robot's velocity by its wheels, over one step.

    Each motor takes its rim towards the commanded speed, with the force that its torque curve
    allows. The axle does not slide sideways, and the rims do not slip, unless that takes more force
    than friction gives; then the wheel's force is what friction gives, in that direction.

    `velocity` (3,) of the centre of mass in the hall, in m/s, and the turning rate in rad/s,
    changed in place; `heading` in rad; `payload` (2,) its mass in kg, and how far before the axle
    it lies in m; `friction` the coefficient between wheels and floor; `rims` (2,) the commanded
    speeds of the left and the right rim, in m/s; `dt_s` the time of the step.
    """
    mass = MASS_KG + payload[0]
    ahead = axle_to_mass(payload[0], payload[1])
    inertia = INERTIA_KG_M2 + MASS_KG * ahead**2 + payload[0] * (payload[1] - ahead) ** 2
    cosine, sine = math.cos(heading), math.sin(heading)
    along = velocity[0] * cosine + velocity[1] * sine
    aside = -velocity[0] * sine + velocity[1] * cosine
    turning = velocity[2]
    wanted, turn = (rims[0] + rims[1]) / 2, (rims[1] - rims[0]) / (2 * TRACK_M)
    # the impulses that would give both rims and the axle exactly the commanded motion
    across = mass * (turn * ahead - aside)
    both = mass * (wanted - along)
    apart = (inertia * (turn - turning) + ahead * across) / TRACK_M
    left, right = (both - apart) / 2, (both + apart) / 2
    # a caster carries the part of the weight that does not lie over the axle
    grip = friction * mass * GRAVITY_M_S2 * (1.0 - abs(ahead) / CASTER_M) / 2 * dt_s
    left = _limited(left, along - turning * TRACK_M, dt_s)
    right = _limited(right, along + turning * TRACK_M, dt_s)
    left_share = min(1.0, grip / max(math.sqrt(left**2 + (across / 2) ** 2), 1e-12))
    right_share = min(1.0, grip / max(math.sqrt(right**2 + (across / 2) ** 2), 1e-12))
    left, right = left * left_share, right * right_share
    across *= (left_share + right_share) / 2
    along += (left + right) / mass
    aside += across / mass
    turning += (TRACK_M * (right - left) - ahead * across) / inertia
    velocity[0] = along * cosine - aside * sine
    velocity[1] = along * sine + aside * cosine
    velocity[2] = turning


@kernel
def _limited(impulse: float, rim_m_s: float, dt_s: float) -> float:
    """Return what a motor can do of an impulse at the rim: less, the faster it turns that way."""
    forwards = STALL_N * min(1.0, max(0.0, 1.0 - rim_m_s / TOP_M_S)) * dt_s
    backwards = STALL_N * min(1.0, max(0.0, 1.0 + rim_m_s / TOP_M_S)) * dt_s
    return min(forwards, max(-backwards, impulse))


@kernel
def velocities(
    poses: Floats,
    velocity: Floats,
    payload: Floats,
    friction: Floats,
    gain: Floats,
    rims: Floats,
    dt_s: float,
) -> Floats:
    """Return the velocities of robots over some steps, (n, steps, 3), each kept for one step.

    `poses` (n, 3) x, y, heading; `velocity` (n, 3), `payload` (n, 2), `friction` (n,) and `rims`
    (n, steps, 2) as `move` has them, `velocity` changed in place to that after the last step;
    `gain` (n,) the share by which the right wheel turns faster than commanded, the left one slower.
    """
    moved = np.empty((len(poses), rims.shape[1], 3))
    worn = np.empty(2)
    for i in range(len(poses)):
        heading = poses[i, 2]
        for k in range(rims.shape[1]):
            worn[0], worn[1] = rims[i, k, 0] * (1.0 - gain[i]), rims[i, k, 1] * (1.0 + gain[i])
            move(velocity[i], heading, payload[i], friction[i], worn, dt_s)
            moved[i, k] = velocity[i]
            heading += velocity[i, 2] * dt_s
    return moved


@kernel
def rims_of(pedal: float, wheel: float) -> tuple[float, float]:
    """Return the speeds of the left and the right rim that an action commands."""
    speed = pedal * FORWARD_M_S if pedal > 0 else pedal * BACKWARD_M_S
    turn = wheel * TURN_RAD_S * TRACK_M
    return speed - turn, speed + turn


@kernel
def delayed_rims(commands: Floats, delays: Integers, steps: int) -> Floats:
    """Return the commanded speeds of rims over the steps of one decision, (n, steps, 2).

    `commands` (n, k, 2) are the last actions, newest first; a command is in force after `delays`
    (n,) steps.
    """
    rims = np.empty((len(commands), steps, 2))
    for i in range(len(commands)):
        for k in range(steps):
            late = -((k - delays[i]) // steps)
            rims[i, k] = rims_of(commands[i, late, 0], commands[i, late, 1])
    return rims
