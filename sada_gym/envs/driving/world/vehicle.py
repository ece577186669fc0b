"""highway-env's vehicle for many cars at once, and where each is on its route.

Scalar loops compiled by numba: what a car does never depends on the others in the batch.
"""

from __future__ import annotations

import math

import numpy as np

from sada_gym.foundations.arrays import Floats, Integers
from sada_gym.foundations.compiled import kernel

LENGTH_M = 5.0
WIDTH_M = 2.0
MAX_STEERING_RAD = math.pi / 4
MAX_ACCELERATION_M_S2 = 5.0
"""These two are the ranges of highway-env's `ContinuousAction`."""
MAX_SPEED_M_S = 40.0
"""Above this speed highway-env's vehicles accelerate no more, and brake."""

_BACK, _AHEAD = 6, 14


@kernel
def drive(states: Floats, steering: Floats, acceleration: Floats, dt_s: float, steps: int) -> None:
    """Move cars, as highway-env's `Vehicle.step` does; brakes stop a car and do not reverse it.

    `states` (n, 4) are x, y, heading and speed, changed in place; `steering` (n,) in rad, positive
    to the right; `acceleration` (n,) in m/s^2; `dt_s` the time of each of `steps`.
    """
    for i in range(states.shape[0]):
        x, y, heading, speed = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        slip = math.atan(0.5 * math.tan(steering[i]))
        turn = math.sin(slip) / (LENGTH_M / 2)
        for _ in range(steps):
            x += speed * math.cos(heading + slip) * dt_s
            y += speed * math.sin(heading + slip) * dt_s
            heading += speed * turn * dt_s
            pedal = acceleration[i]
            if speed > MAX_SPEED_M_S:
                pedal = min(pedal, MAX_SPEED_M_S - speed)
            speed = max(0.0, speed + pedal * dt_s)
        states[i, 0], states[i, 1], states[i, 2], states[i, 3] = x, y, heading, speed


@kernel
def locate(
    states: Floats, points: Floats, heading: Floats, first: Integers, last: Integers, at: Integers
) -> tuple[Floats, Floats]:
    """Find where cars are on their routes.

    A car is looked for near where it was, so that a route may cross itself.

    `states` (n, 4) of the cars; `points` (k, 2) and `heading` (k,) of all routes, one after
    another; `first` and `last` (n,) the indices of each route's ends; `at` (n,) the nearest point
    at the last call, changed in place. Returns how far each car is past its nearest point, and how
    far to the right of it, in m.
    """
    n = states.shape[0]
    along, lateral = np.empty(n), np.empty(n)
    for i in range(n):
        x, y = states[i, 0], states[i, 1]
        nearest, minimum = at[i], math.inf
        for k in range(max(first[i], at[i] - _BACK), min(last[i], at[i] + _AHEAD) + 1):
            squared = (points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2
            if squared < minimum:
                nearest, minimum = k, squared
        at[i] = nearest
        dx, dy = x - points[nearest, 0], y - points[nearest, 1]
        cosine, sine = math.cos(heading[nearest]), math.sin(heading[nearest])
        along[i] = dx * cosine + dy * sine
        lateral[i] = -dx * sine + dy * cosine
    return along, lateral
