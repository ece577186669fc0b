"""A racing quadrotor as a rigid body in PyBullet, many at once, with its flight controller.

Body frame: x forward, y left, z up. Mass, inertia, the rotors' places and the thrust-to-weight
ratio are those of the racing drone of gym-pybullet-drones (Panerati et al. 2021, `racer.urdf`). The
controller is geometric (Lee, Leok, McClamroch 2010): wanted velocity -> acceleration -> attitude ->
body rates -> rotors, at 240 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba as nb
import numpy as np
import numpy.typing as npt
import pybullet

from sada_gym.envs.uav.gates import BARS, DEPTH_M

SIMULATION_HZ = 240
MASS_KG = 0.830
INERTIA_KG_M2 = 3.113e-3
"""About every axis."""
THRUST_TO_WEIGHT = 4.17
ARM_X_M, ARM_Y_M = 0.0850, 0.0675
"""Where the rotors are, to the front and to the side."""
TORQUE_PER_THRUST_M = 0.127 * 0.05 / (2 * math.pi * 0.1)
"""A rotor's drag torque over its thrust: C_P / (2 pi C_T) times the diameter, of a propeller of
five inches. `racer.urdf` has a quarter of it, which no such propeller has."""
GRAVITY_M_S2 = 9.81
MAX_ROTOR_N = THRUST_TO_WEIGHT * MASS_KG * GRAVITY_M_S2 / 4
ROTOR_LAG_S = 0.03
DRAG_PER_S = 0.3
"""Linear drag over mass, of the size that Faessler, Franchi and Scaramuzza (2018) measured."""
BODY_M = (0.24, 0.20, 0.06)
"""The box that touches frames and ground."""
RESTITUTION, FRICTION = 0.6, 0.3

MAX_TILT_RAD = math.radians(60.0)
VELOCITY_GAIN_PER_S = 5.0
ATTITUDE_GAIN_PER_S = 10.0
RATE_GAIN_PER_S = 22.0
MAX_CLIMB_M_S2, MAX_SINK_M_S2 = 10.0, 6.0
_YAW_SHARE = 0.3
"""Of a rotor's greatest thrust, that yaw may take: roll and pitch come first."""

SLOTS = 16
"""Drones in one world. They share its coordinates and never meet: each has a filter bit."""
FRAMES = 4
"""Gates of each drone that are solid at a time: those that it could touch before it decides again.
The others would touch nothing, and cost time."""
REACH_M = 2.0
"""Frames nearer than that, seen from above, are solid."""

Array = npt.NDArray[np.float64]
Body = tuple[float, ...]

_GROUND_BIT = 1 << SLOTS
_IDLE: list[int] = []
"""Clients that no world uses: to connect one takes as long as a race."""
_MOST_IDLE = 4
_kernel = nb.njit(cache=True, nogil=True, error_model="numpy")
_LAG = 1.0 - math.exp(-1.0 / (SIMULATION_HZ * ROTOR_LAG_S))
_SIGNS = np.array([[1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]])
"""Of each rotor: the sides it is on, x and y, and the sign of its drag torque."""


@_kernel
def heading_of(x: float, y: float, z: float, w: float) -> float:
    """The heading of an attitude: where the body's x axis points, seen from above."""
    return math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))


@_kernel
def rotation(x: float, y: float, z: float, w: float) -> Array:
    """The matrix of a quaternion; its columns are the body's axes."""
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return r


@_kernel
def wanted_attitude(force: Array, heading: float) -> Array:
    """The attitude whose z axis is along a force and whose x axis points to a heading.

    The x axis lies exactly above the heading, however the body leans, so that a camera does not
    swing when the drone does.

    Args:
        force: (3,) with an upward part.
        heading: In rad.
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


@_kernel
def _wanted_force(velocity: Array, wanted: Array) -> Array:
    """The force over mass that brings the velocity to the wanted one, within the tilt allowed."""
    force = np.empty(3)
    for k in range(3):
        force[k] = VELOCITY_GAIN_PER_S * (wanted[k] - velocity[k]) + DRAG_PER_S * velocity[k]
    force[2] = GRAVITY_M_S2 + min(max(force[2], -MAX_SINK_M_S2), MAX_CLIMB_M_S2)
    level = math.hypot(force[0], force[1])
    most = force[2] * math.tan(MAX_TILT_RAD)
    if level > most:
        force[0] *= most / level
        force[1] *= most / level
    return force


@_kernel
def _rotors(thrust: float, torque: Array) -> Array:
    """Share thrust and torques among the rotors; where they can't give all, yaw yields first."""
    share = np.empty(4)
    yaw = torque[2] / (4 * TORQUE_PER_THRUST_M)
    yaw = min(max(yaw, -_YAW_SHARE * MAX_ROTOR_N), _YAW_SHARE * MAX_ROTOR_N)
    low, high = math.inf, -math.inf
    for i in range(4):
        share[i] = (
            _SIGNS[i, 1] * torque[0] / (4 * ARM_Y_M)
            - _SIGNS[i, 0] * torque[1] / (4 * ARM_X_M)
            + _SIGNS[i, 2] * yaw
        )
        low, high = min(low, share[i]), max(high, share[i])
    each = min(max(thrust / 4, -low), MAX_ROTOR_N - high)
    for i in range(4):
        share[i] = min(max(each + share[i], 0.0), MAX_ROTOR_N)
    return share


@_kernel
def control(
    states: Array, commands: Array, headings: Array, rotors: Array, wrenches: Array
) -> None:
    """One step of the flight controller and the rotors, of n drones.

    Args:
        states: (n, 13) position, quaternion xyzw, velocity and angular velocity, in the world.
        commands: (n, 4) wanted velocity in the world in m/s, and turning rate in rad/s.
        headings: (n,) wanted heading; changed in place.
        rotors: (n, 4) thrust in N; changed in place.
        wrenches: (n, 6) filled with force and torque on the body, in the world.
    """
    error, torque = np.empty(3), np.empty(3)
    for i in range(states.shape[0]):
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
            wrenches[i, k] = r[k, 2] * thrust - MASS_KG * DRAG_PER_S * s[7 + k]
            wrenches[i, 3 + k] = r[k, 0] * torque[0] + r[k, 1] * torque[1] + r[k, 2] * torque[2]


class World:
    """A PyBullet world with up to `SLOTS` drones, each among gates of its own.

    All drones fly at the same coordinates, and what is in one slot touches the ground and what else
    is in that slot only.
    """

    def __init__(self) -> None:
        self._client = _IDLE.pop() if _IDLE else pybullet.connect(pybullet.DIRECT)
        self._bodies: list[list[int]] = [[] for _ in range(SLOTS)]
        self._solid: list[tuple[int, ...]] = [(-1,) * FRAMES for _ in range(SLOTS)]
        self._build()

    def _build(self) -> None:
        client = self._client
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / SIMULATION_HZ,
            numSubSteps=0,
            deterministicOverlappingPairs=1,
            # drones must be solved each for itself: no common end of the iteration, no common batch
            solverResidualThreshold=0,
            minimumSolverIslandSize=1,
            physicsClientId=client,
        )
        plane = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[200, 200, 1], physicsClientId=client
        )
        ground = self._body(plane, [0, 0, -1], [0, 0, 0, 1], _GROUND_BIT, _GROUND_BIT - 1)
        assert ground == 0
        self._shell = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[size / 2 for size in BODY_M], physicsClientId=client
        )
        self._frame = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(BARS),
            halfExtents=[[DEPTH_M / 2, y, z] for _, _, y, z in BARS.tolist()],
            collisionFramePositions=[[0, y, z] for y, z, _, _ in BARS.tolist()],
            physicsClientId=client,
        )

    def _body(
        self,
        shape: int,
        place: Sequence[float],
        attitude: Sequence[float],
        group: int,
        mask: int,
        mass: float = 0.0,
    ) -> int:
        client = self._client
        body: int = pybullet.createMultiBody(
            mass, shape, -1, place, attitude, physicsClientId=client
        )
        pybullet.setCollisionFilterGroupMask(body, -1, group, mask, physicsClientId=client)
        pybullet.changeDynamics(
            body,
            -1,
            restitution=RESTITUTION,
            lateralFriction=FRICTION,
            linearDamping=0,
            angularDamping=0,
            physicsClientId=client,
        )
        return body

    def clear(self, slot: int) -> None:
        """Take everything out of a slot."""
        for body in self._bodies[slot]:
            pybullet.removeBody(body, physicsClientId=self._client)
        self._bodies[slot] = []
        self._solid[slot] = (-1,) * FRAMES

    def fill(self, slot: int, state: Array) -> None:
        """Put a drone in a state (13,) and its frames into a slot; what was there goes."""
        self.clear(slot)
        bit = 1 << slot
        shell = self._body(self._shell, [0, 0, 9], [0, 0, 0, 1], bit, bit | _GROUND_BIT, MASS_KG)
        pybullet.changeDynamics(
            shell, -1, localInertiaDiagonal=[INERTIA_KG_M2] * 3, physicsClientId=self._client
        )
        self._bodies[slot] = [shell]
        for number in range(FRAMES):
            stored = _stored(slot, number)
            self._bodies[slot].append(self._body(self._frame, stored, [0, 0, 0, 1], bit, bit))
        self.place(slot, state)

    def surround(self, slot: int, gates: Array, near: Sequence[int]) -> None:
        """Make some of the gates (g, 4) solid, and only those.

        Args:
            slot: The slot.
            gates: All gates of its track.
            near: `FRAMES` indices of gates; -1 where there are no more.
        """
        solid = self._solid[slot]
        if set(solid) == set(near):
            return
        kept = [k if k in near else -1 for k in solid]
        for k in near:
            if k not in kept:
                kept[kept.index(-1)] = k
        for number, (old, new) in enumerate(zip(solid, kept, strict=True)):
            if old != new:
                body = self._bodies[slot][1 + number]
                if new < 0:
                    place, turn = _stored(slot, number), 0.0
                else:
                    *place, turn = gates[new].tolist()
                attitude = [0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)]
                pybullet.resetBasePositionAndOrientation(
                    body, place, attitude, physicsClientId=self._client
                )
        self._solid[slot] = tuple(kept)

    def place(self, slot: int, state: Array) -> None:
        """Set a slot's drone to a state (13,); an empty slot stays empty."""
        if not self._bodies[slot]:
            return
        body, values = self._bodies[slot][0], state.tolist()
        pybullet.resetBasePositionAndOrientation(
            body, values[:3], values[3:7], physicsClientId=self._client
        )
        pybullet.resetBaseVelocity(body, values[7:10], values[10:], physicsClientId=self._client)

    def push(self, slots: Sequence[int], states: Array, wrenches: Array) -> Array:
        """Let forces and torques act on some drones for one step, and give their states.

        Args:
            slots: (n,) those.
            states: (n, 13) where they are.
            wrenches: (n, 6) force and torque in the world.
        """
        client, frame = self._client, pybullet.WORLD_FRAME
        bodies = [self._bodies[slot][0] for slot in slots]
        places = states[:, :3].tolist()
        for body, place, wrench in zip(bodies, places, wrenches.tolist(), strict=True):
            pybullet.applyExternalForce(body, -1, wrench[:3], place, frame, client)
            pybullet.applyExternalTorque(body, -1, wrench[3:], frame, client)
        pybullet.stepSimulation(client)
        after: list[Body] = []
        for body in bodies:
            place, attitude = pybullet.getBasePositionAndOrientation(body, client)
            velocity, spin = pybullet.getBaseVelocity(body, client)
            after.append(place + attitude + velocity + spin)
        return np.array(after)

    def close(self) -> None:
        """Free the world; doing it again is fine."""
        if self._client >= 0:
            if len(_IDLE) < _MOST_IDLE:
                _IDLE.append(self._client)
            else:
                pybullet.disconnect(self._client)
            self._client = -1

    def __del__(self) -> None:
        """Free what nobody freed."""
        if pybullet is not None:  # at the interpreter's end modules go first
            self.close()

    def __getstate__(self) -> None:
        """A world lives in the process that made it."""
        raise TypeError("Expected no pickling of a PyBullet world. Make the races anew instead.")


def _stored(slot: int, number: int) -> list[float]:
    """Where a frame waits that is not needed: below the ground, apart from all others."""
    return [5.0 * slot, 5.0 * number, -20.0]


def upright(place: Sequence[float], heading: float) -> Array:
    """The state (13,) of a drone at rest."""
    state = np.zeros(13)
    state[:3] = place
    state[5:7] = math.sin(heading / 2), math.cos(heading / 2)
    return state


def headings(states: Array) -> Array:
    """The headings of drones (n, 13), (n,)."""
    return _headings(np.ascontiguousarray(states))


@_kernel
def _headings(states: Array) -> Array:
    found = np.empty(len(states))
    for i in range(len(states)):
        found[i] = heading_of(states[i, 3], states[i, 4], states[i, 5], states[i, 6])
    return found
