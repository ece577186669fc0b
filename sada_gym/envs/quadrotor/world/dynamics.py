"""Flights of quadrotors: the rigid body and its motors, the reference, and what sensors tell.

The equations and the integrator are those of RAPTOR's authors' simulator, `l2f` 2.0.18: one step of
Runge-Kutta at 100 Hz. Drag and wind are added. One quadrotor after the other is computed, so that
it makes no difference which others fly.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.quadrotor.start import GRAVITY_M_S2
from sada_gym.foundations.arrays import Floats, Floats32, Indices, Integers
from sada_gym.foundations.compiled import kernel

STATE = 17
"""Position, quaternion wxyz, velocity, body rates, and the throttle of each motor from 0 to 1."""
STEP_S = 0.01
STEPS, SETTLED = 1_000, 200
"""The steps of a flight, and those at its beginning in which it is not judged."""
BOUND_M, LOST_M = 0.3, 3.0
"""A quadrotor is near its reference up to the first distance, and lost from the second one on."""
WIDTH_M, DEPTH_M, RAMP_S = 1.0, 0.5, 3.0
"""How far the figure of eight reaches along x and y, and how long its reference gets faster: the
defaults of PX4's module `mc_raptor` (`lissajous.hpp`)."""
HEIGHT_M = 1.5
MEASURED = 18
"""Position and velocity less the reference's, rotation matrix and body rates."""
NEAR_M, NEAR_M_S = 0.5, 1.0
"""The module cuts errors of position and velocity off at these before RAPTOR sees them."""
AGES = 3
"""So many measurements are kept, as many as the longest delay needs, and one more."""
FLIGHT, TOLD = 5, 6
"""Numbers of a flight (wind, gusts, noise, delay, speed) and of what became of it."""
_KEPT, _FRESH = 0.99, math.sqrt(1.0 - 0.99**2)
"""The share of a gust that a step leaves (gusts last about a second), and what is new."""


@kernel
def _change(s: Floats, throttle: Floats, body: Floats, motors: Floats, wind: Floats) -> Floats:
    """Return the time derivative of a state (17,)."""
    change = np.empty(STATE)
    lift = x_torque = y_torque = z_torque = 0.0
    for i in range(4):
        motor, speed = motors[6 * i : 6 * i + 6], s[13 + i]
        thrust = motor[3] + motor[4] * speed + motor[5] * speed * speed
        lift += thrust
        x_torque += motor[1] * thrust
        y_torque -= motor[0] * thrust
        z_torque += motor[2] * thrust
        change[13 + i] = (throttle[i] - speed) / (body[4] if throttle[i] >= speed else body[5])
    w, x, y, z = s[3], s[4], s[5], s[6]
    p, q, r = s[10], s[11], s[12]
    change[:3] = s[7:10]
    change[3] = 0.5 * (-x * p - y * q - z * r)
    change[4] = 0.5 * (w * p + y * r - z * q)
    change[5] = 0.5 * (w * q + z * p - x * r)
    change[6] = 0.5 * (w * r + x * q - y * p)
    pull = lift / body[0]
    change[7] = 2.0 * (x * z + w * y) * pull
    change[8] = 2.0 * (y * z - w * x) * pull
    change[9] = (1.0 - 2.0 * (x * x + y * y)) * pull - GRAVITY_M_S2
    for k in range(3):
        change[7 + k] += body[6] * (wind[k] - s[7 + k])
    change[10] = (x_torque - (body[3] - body[2]) * q * r) / body[1]
    change[11] = (y_torque - (body[1] - body[3]) * r * p) / body[2]
    change[12] = (z_torque - (body[2] - body[1]) * p * q) / body[3]
    return change


@kernel
def fly(s: Floats, action: Floats, body: Floats, motors: Floats, wind: Floats) -> None:
    """Take one step of one quadrotor, whose state `s` (17,) is changed in place.

    `action` (4,) is from -1 to 1; `body` (7,) mass, moments of inertia, time constants of the
    motors up and down, and drag over mass and airspeed; `motors` (24,) each one's x and y from the
    centre of mass, its torque about z over its thrust, and its thrust curve; `wind` (3,) in m/s.
    """
    throttle = 0.5 * action + 0.5
    first = _change(s, throttle, body, motors, wind)
    second = _change(s + 0.5 * STEP_S * first, throttle, body, motors, wind)
    third = _change(s + 0.5 * STEP_S * second, throttle, body, motors, wind)
    fourth = _change(s + STEP_S * third, throttle, body, motors, wind)
    for k in range(STATE):
        s[k] += STEP_S / 6.0 * (first[k] + 2.0 * second[k] + 2.0 * third[k] + fourth[k])
    size = math.sqrt(s[3] * s[3] + s[4] * s[4] + s[5] * s[5] + s[6] * s[6])
    for k in range(4):
        s[3 + k] /= size
        s[13 + k] = min(max(s[13 + k], 0.0), 1.0)


@kernel
def _circle(angle: float) -> tuple[float, float]:
    """Return cosine and sine to 1e-9 by sums and products alone, the same bits everywhere."""
    x = angle / 1024.0
    square = x * x
    cosine = 1.0 - square / 2.0 + square * square / 24.0
    sine = x * (1.0 - square / 6.0 + square * square / 120.0)
    for _ in range(10):
        cosine, sine = cosine * cosine - sine * sine, 2.0 * cosine * sine
    return cosine, sine


@kernel
def reference(time_s: float, speed_m_s: float) -> tuple[float, float, float, float]:
    """Return where the reference is, x and y in m, and its velocity, which is greatest midway."""
    ramp = min(time_s / RAMP_S, 1.0)
    rate = speed_m_s / math.sqrt(WIDTH_M * WIDTH_M + 4.0 * DEPTH_M * DEPTH_M)
    cosine, sine = _circle(rate * (0.5 * ramp * min(time_s, RAMP_S) + max(time_s - RAMP_S, 0.0)))
    x_speed, y_speed = WIDTH_M * rate * ramp, 2.0 * DEPTH_M * rate * ramp
    x, y = WIDTH_M * sine, DEPTH_M * 2.0 * sine * cosine
    return x, y, x_speed * cosine, y_speed * (2.0 * cosine * cosine - 1.0)


@kernel
def measure(s: Floats, target: Floats, noise: Floats32, amount: float, seen: Floats) -> None:
    """Write what sensors tell of a state (17,), (18,).

    `amount` is the standard deviation of positions and of the rotation matrix; velocities and body
    rates have twice as much.
    """
    w, x, y, z = s[3], s[4], s[5], s[6]
    seen[0], seen[1], seen[2] = s[0] - target[0], s[1] - target[1], s[2] - HEIGHT_M
    seen[3], seen[4], seen[5] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    seen[6], seen[7], seen[8] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    seen[9], seen[10], seen[11] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    seen[12], seen[13], seen[14] = s[7] - target[2], s[8] - target[3], s[9]
    seen[15:] = s[10:13]
    for k in range(MEASURED):
        seen[k] += amount * noise[k] * (1.0 if k < 12 else 2.0)


@kernel
def observe(
    which: Indices, seen: Floats, flights: Floats, actions: Floats, observed: Floats32
) -> None:
    """Write the observations, (k, 22), of some of n quadrotors: see `QuadrotorEpisodes`.

    `seen` (n, AGES, 18) are the last measurements, newest first.
    """
    for row, i in enumerate(which):
        age = flights[i, 3] / STEP_S
        whole = int(age)
        for k in range(MEASURED):
            newer, older = seen[i, whole, k], seen[i, whole + 1, k]
            most = NEAR_M if k < 3 else NEAR_M_S if 12 <= k < 15 else 100.0
            observed[row, k] = min(max(newer + (age - whole) * (older - newer), -most), most)
        observed[row, MEASURED:] = actions[i]


@kernel
def advance(
    which: Indices,
    airframes: Floats,
    flights: Floats,
    noise: Floats32,
    steps: Integers,
    actions: Floats,
    now: Floats,
    seen: Floats,
) -> None:
    """Take a step of some of n flights, one after the other; see `QuadrotorEpisodes`."""
    for i in which:
        step, s, target = steps[i], now[i, :STATE], now[i, STATE : STATE + 4]
        wind, told = now[i, STATE + 4 : STATE + 7], now[i, STATE + 7 :]
        fly(s, actions[i], airframes[i, :7], airframes[i, 7:], wind)
        for k in range(3):
            steady = flights[i, 0] if k == 0 else 0.0
            fresh = _FRESH * flights[i, 1] * noise[i, step, MEASURED + k]
            wind[k] = steady + _KEPT * (wind[k] - steady) + fresh
        target[0], target[1], target[2], target[3] = reference(step * STEP_S, flights[i, 4])
        for age in range(AGES - 1, 0, -1):
            seen[i, age] = seen[i, age - 1]
        measure(s, target, noise[i, step], flights[i, 2], seen[i, 0])
        x, y, z = s[0] - target[0], s[1] - target[1], s[2] - HEIGHT_M
        told[0] = math.sqrt(x * x + y * y + z * z)
        if step > SETTLED:
            told[1] += told[0] <= BOUND_M
            told[2] = max(told[2], told[0])
        told[3] += STEP_S * math.sqrt(s[10] * s[10] + s[11] * s[11] + s[12] * s[12])
        if told[4] == 0.0 and s[4] * s[4] + s[5] * s[5] > 0.5:
            told[4] = step
        if s[2] <= 0.0:
            told[5] = 2.0  # FlightEnd.CRASHED
        elif told[0] >= LOST_M:
            told[5] = 3.0  # FlightEnd.LOST
        elif step >= STEPS:
            told[5] = 1.0  # FlightEnd.FLOWN
