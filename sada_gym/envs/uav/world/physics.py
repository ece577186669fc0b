"""PyBullet moves drones as free rigid bodies, all of a batch in one client.

What a drone touches is geometry (`contact`), so bodies have no shape and never meet. Forces and
torques reach PyBullet as the velocities that they give: of a free body whose moments of inertia are
equal, that is all they do.
"""

from __future__ import annotations

import threading
from itertools import chain

import numpy as np

from sada_gym.envs.bullet import pybullet
from sada_gym.envs.uav.world.drone import INERTIA_KG_M2, MASS_KG, SIMULATION_HZ
from sada_gym.foundations.arrays import Floats


class FreeBodies:
    """As many bodies as fly at a time, in a PyBullet client of their own."""

    def __init__(self) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        self._bodies: list[int] = []
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1 / SIMULATION_HZ, numSubSteps=0, physicsClientId=self._client
        )

    def place(self, poses: Floats) -> None:
        """Set bodies to poses, one for each of (n, 7): position, quaternion xyzw."""
        client = self._client
        while len(self._bodies) > len(poses):  # they would cost time in every step
            pybullet.removeBody(self._bodies.pop(), physicsClientId=client)
        while len(self._bodies) < len(poses):
            self._bodies.append(self._new_body())
        for body, pose in zip(self._bodies, poses.tolist(), strict=True):
            pybullet.resetBasePositionAndOrientation(body, pose[:3], pose[3:], client)

    def step(self, velocities: Floats) -> Floats:
        """Move the bodies for one step of the simulation.

        `velocities` (n, 6) velocity and angular velocity of each, in the world. Returns their
        poses, (n, 7).
        """
        client = self._client
        for body, values in zip(self._bodies, velocities.tolist(), strict=True):
            pybullet.resetBaseVelocity(body, values[:3], values[3:], client)
        pybullet.stepSimulation(client)
        poses = [pybullet.getBasePositionAndOrientation(body, client) for body in self._bodies]
        values = chain.from_iterable(chain.from_iterable(poses))
        return np.fromiter(values, np.float64, 7 * len(poses)).reshape(-1, 7)

    def _new_body(self) -> int:
        body: int = pybullet.createMultiBody(MASS_KG, physicsClientId=self._client)
        pybullet.changeDynamics(
            body,
            -1,
            localInertiaDiagonal=[INERTIA_KG_M2] * 3,
            linearDamping=0,
            angularDamping=0,
            physicsClientId=self._client,
        )
        # without a filter PyBullet would pair all bodies that are near one another
        pybullet.setCollisionFilterGroupMask(body, -1, 0, 0, physicsClientId=self._client)
        return body

    def __del__(self) -> None:
        """Free the client."""
        if pybullet is not None:  # at the interpreter's end modules go first
            pybullet.disconnect(self._client)


_LOCAL = threading.local()


def free_bodies() -> FreeBodies:
    """Return this thread's bodies: connecting a client takes as long as a race."""
    if not hasattr(_LOCAL, "bodies"):
        _LOCAL.bodies = FreeBodies()
    bodies: FreeBodies = _LOCAL.bodies
    return bodies
