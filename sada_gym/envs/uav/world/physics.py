"""PyBullet worlds: drones as rigid bodies among solid frames, many in one world."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.envs.bullet import pybullet
from sada_gym.envs.uav.world.drone import GRAVITY_M_S2, INERTIA_KG_M2, MASS_KG, SIMULATION_HZ
from sada_gym.envs.uav.world.gates import BARS, DEPTH_M
from sada_gym.errors import UserTypeError

BODY_M = (0.24, 0.20, 0.06)
"""The size of the box that touches frames and ground."""
RESTITUTION, FRICTION = 0.6, 0.3

SLOTS = 16
"""The most drones in one world. They share coordinates and never meet: each has a filter bit."""
FRAMES = 3
"""The number of gates that are solid for each drone at a time: those that it could touch before it
decides again. The others would touch nothing, and cost time."""
REACH_M = 2.0
"""Frames that are nearer than this, seen from above, are solid."""

Array = npt.NDArray[np.float64]
Body = tuple[float, ...]

_GROUND_BIT = 1 << SLOTS
_IDLE: list[int] = []
"""Clients that no world uses. They are kept, since connecting one takes as long as a race."""
_MOST_IDLE = 4


class BulletWorld:
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
        self._bars = [
            pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=[DEPTH_M / 2, y, z], physicsClientId=client
            )
            for _, _, y, z in BARS.tolist()
        ]

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
        """Put a drone in a state (13,) and its frames into a slot, and remove what was there."""
        self.clear(slot)
        bit = 1 << slot
        shell = self._body(self._shell, [0, 0, 9], [0, 0, 0, 1], bit, bit | _GROUND_BIT, MASS_KG)
        pybullet.changeDynamics(
            shell, -1, localInertiaDiagonal=[INERTIA_KG_M2] * 3, physicsClientId=self._client
        )
        self._bodies[slot] = [shell]
        # A bar is a body of its own: of a frame as one body, Bullet takes contacts with two bars
        # in an order that depends on who else is in the world.
        for number in range(FRAMES):
            for bar, shape in enumerate(self._bars):
                stored = _stored(slot, number, bar)
                self._bodies[slot].append(self._body(shape, stored, [0, 0, 0, 1], bit, bit))
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
                self._move(slot, number, None if new < 0 else gates[new].tolist())
        self._solid[slot] = tuple(kept)

    def _move(self, slot: int, number: int, gate: list[float] | None) -> None:
        """Put a frame's bars where a gate is, or out of the way."""
        x, y, z, turn = gate or (0.0, 0.0, 0.0, 0.0)
        sine, cosine = math.sin(turn), math.cos(turn)
        attitude = [0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)]
        for bar, (left, up) in enumerate(BARS[:, :2].tolist()):
            place = [x - left * sine, y + left * cosine, z + up]
            pybullet.resetBasePositionAndOrientation(
                self._bodies[slot][1 + len(BARS) * number + bar],
                place if gate else _stored(slot, number, bar),
                attitude,
                physicsClientId=self._client,
            )

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
            slots: (n,) the slots of these drones.
            states: (n, 13) of these drones.
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
        """Refuse to pickle: a world lives in the process that made it."""
        raise UserTypeError(
            "Expected no pickling of a PyBullet world. Make the races anew instead."
        )


def _stored(slot: int, number: int, bar: int) -> list[float]:
    """Give the place where an unneeded bar waits: below the ground, apart from all others."""
    return [5.0 * slot, 5.0 * number, -20.0 - 10.0 * bar]
