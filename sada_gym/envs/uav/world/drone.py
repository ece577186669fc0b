"""A racing quadrotor: its rotors and its flight controller, for many at once.

Body frame: x forward, y left, z up. Mass, inertia, the rotors' places and the thrust-to-weight
ratio are those of the racing drone of gym-pybullet-drones (Panerati et al. 2021, `racer.urdf`). The
controller is geometric (Lee, Leok, McClamroch 2010): wanted velocity -> acceleration -> attitude ->
body rates -> rotors, at 240 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sada_gym.foundations.arrays import Floats, Indices
from sada_gym.foundations.compiled import kernel

SIMULATION_HZ = 240
MASS_KG = 0.830
INERTIA_KG_M2 = 3.113e-3
"""The moment of inertia, the same about every axis."""
THRUST_TO_WEIGHT = 4.17
ARM_X_M, ARM_Y_M = 0.0850, 0.0675
"""The rotors' distances from the middle, to the front and to the side."""
TORQUE_PER_THRUST_M = 0.127 * 0.05 / (2 * math.pi * 0.1)
"""A rotor's drag torque over its thrust: C_P / (2 pi C_T) times the diameter, of a propeller of
five inches. `racer.urdf` has a quarter of it, too little for such a propeller."""
GRAVITY_M_S2 = 9.81
MAX_ROTOR_N = THRUST_TO_WEIGHT * MASS_KG * GRAVITY_M_S2 / 4
ROTOR_LAG_S = 0.03
DRAG_PER_S = 0.3
"""Linear drag over mass, about as much as Faessler, Franchi and Scaramuzza (2018) measured."""
MAX_TILT_RAD = math.radians(60.0)
VELOCITY_GAIN_PER_S = 5.0
ATTITUDE_GAIN_PER_S = 10.0
RATE_GAIN_PER_S = 22.0
MAX_CLIMB_M_S2, MAX_SINK_M_S2 = 10.0, 6.0
_YAW_SHARE = 0.3
"""The share of a rotor's greatest thrust that yaw may take: roll and pitch come first."""

_LAG = 1.0 - math.exp(-1.0 / (SIMULATION_HZ * ROTOR_LAG_S))
_SIGNS = np.array([[1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]])
"""Each rotor's row: the sides on which it is, x and y, and the sign of its drag torque."""


@kernel
def heading_of(x: float, y: float, z: float, w: float) -> float:
    """Return the heading of an attitude: where the body's x axis points, seen from above."""
    return math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))


@kernel
def rotation(x: float, y: float, z: float, w: float) -> Floats:
    """Return the matrix of a quaternion; its columns are the body's axes."""
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return r


@kernel
def wanted_attitude(force: Floats, heading: float) -> Floats:
    """Return the attitude whose z axis is along a force and whose x axis points to a heading.

    The x axis lies exactly above the heading, however the body leans, so that a camera does not
    swing when the drone does.
    The force (3,) has an upward part; the heading is in rad.
    """
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    z0, z1, z2 = force[0] / size, force[1] / size, force[2] / size
    x0, x1 = math.cos(heading), math.sin(heading)
    x2 = -(x0 * z0 + x1 * z1) / z2
    size = math.sqrt(1 + x2 * x2)
    x0, x1, x2 = x0 / size, x1 / size, x2 / size
    r = np.empty((3, 3))
    r[0, 0], r[1, 0], r[2, 0] = x0, x1, x2
    r[0, 1], r[1, 1], r[2, 1] = z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0
    r[0, 2], r[1, 2], r[2, 2] = z0, z1, z2
    return r


@kernel
def _wanted_force(velocity: Floats, wanted: Floats) -> Floats:
    """Return the force over mass that leads to the wanted velocity, within the tilt allowed."""
    force = np.empty(3)
    for k in range(3):
        force[k] = VELOCITY_GAIN_PER_S * (wanted[k] - velocity[k]) + DRAG_PER_S * velocity[k]
    force[2] = GRAVITY_M_S2 + min(max(force[2], -MAX_SINK_M_S2), MAX_CLIMB_M_S2)
    level = math.hypot(force[0], force[1])
    maximum = force[2] * math.tan(MAX_TILT_RAD)
    if level > maximum:
        force[0] *= maximum / level
        force[1] *= maximum / level
    return force


@kernel
def _rotors(thrust: float, torque: Floats) -> Floats:
    """Share thrust and torques among the rotors; where they can't give all, yaw yields first."""
    share = np.empty(4)
    maximum = 0.0
    for i in range(4):
        share[i] = _SIGNS[i, 1] * torque[0] / (4 * ARM_Y_M) - _SIGNS[i, 0] * torque[1] / (
            4 * ARM_X_M
        )
        maximum = max(maximum, abs(share[i]))
    each = min(max(thrust / 4, maximum), MAX_ROTOR_N - maximum)
    yaw = torque[2] / (4 * TORQUE_PER_THRUST_M)
    for i in range(4):
        share[i] += each
        room = min(share[i], MAX_ROTOR_N - share[i], _YAW_SHARE * MAX_ROTOR_N)
        room = max(room, 0.0)
        yaw = min(max(yaw, -room), room)
    for i in range(4):
        share[i] = min(max(share[i] + _SIGNS[i, 2] * yaw, 0.0), MAX_ROTOR_N)
    return share


@kernel
def control(
    which: Indices, states: Floats, commands: Floats, headings: Floats, rotors: Floats
) -> None:
    """Take one step of the flight controller, the rotors and the velocities of some of n drones.

    `which` are their indices; `states` (n, 13) position, quaternion xyzw, velocity and angular
    velocity, in the world; `commands` (n, 4) wanted velocity in the world in m/s, and turning rate
    in rad/s; `headings` (n,) wanted; `rotors` (n, 4) thrust in N. Velocities, headings and rotors
    are changed in place.
    """
    error, torque = np.empty(3), np.empty(3)
    for i in which:
        s = states[i]
        r = rotation(s[3], s[4], s[5], s[6])
        headings[i] += commands[i, 3] / SIMULATION_HZ
        force = _wanted_force(s[7:10], commands[i, :3])
        want = wanted_attitude(force, headings[i])
        # the rotation from the body to the attitude wanted, as half its sine about each axis
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            error[k] = 0.0
            for m in range(3):
                error[k] += 0.5 * (r[m, a] * want[m, b] - r[m, b] * want[m, a])
        for k in range(3):
            rate = r[0, k] * s[10] + r[1, k] * s[11] + r[2, k] * s[12]
            wanted = -ATTITUDE_GAIN_PER_S * error[k] + r[2, k] * commands[i, 3]
            torque[k] = INERTIA_KG_M2 * RATE_GAIN_PER_S * (wanted - rate)
        lift = force[0] * r[0, 2] + force[1] * r[1, 2] + force[2] * r[2, 2]
        wanted_rotors = _rotors(MASS_KG * max(lift, 0.0), torque)
        thrust = 0.0
        torque[:] = 0.0
        for k in range(4):
            rotors[i, k] += _LAG * (wanted_rotors[k] - rotors[i, k])
            thrust += rotors[i, k]
            torque[0] += _SIGNS[k, 1] * ARM_Y_M * rotors[i, k]
            torque[1] -= _SIGNS[k, 0] * ARM_X_M * rotors[i, k]
            torque[2] += _SIGNS[k, 2] * TORQUE_PER_THRUST_M * rotors[i, k]
        for k in range(3):
            pull = r[k, 2] * thrust / MASS_KG - DRAG_PER_S * s[7 + k]
            pull -= GRAVITY_M_S2 if k == 2 else 0.0
            turn = r[k, 0] * torque[0] + r[k, 1] * torque[1] + r[k, 2] * torque[2]
            s[7 + k] += pull / SIMULATION_HZ
            s[10 + k] += turn / INERTIA_KG_M2 / SIMULATION_HZ


def upright(place: Sequence[float], heading: float) -> Floats:
    """Return the state (13,) of a drone at rest."""
    state = np.zeros(13)
    state[:3] = place
    state[5:7] = math.sin(heading / 2), math.cos(heading / 2)
    return state
