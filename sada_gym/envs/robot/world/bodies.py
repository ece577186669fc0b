"""The rigid bodies of one trip in pymunk: the robot, the carts, and all that stands in the hall."""

from __future__ import annotations

import math
from typing import Any

import pymunk

from sada_gym.envs.robot.world.floor_plan import CART_RADIUS_M, HALL_M, FloorPlan
from sada_gym.envs.robot.world.robot import RADIUS_M
from sada_gym.foundations.arrays import Floats

_ROBOT = 1


class Bodies:
    """A space of its own for each trip.

    The grip of the wheels decides the robot's velocity. pymunk integrates it, and finds the first
    contact.
    `pose` (3,) is x, y of the axle's middle and the heading, `carts` (c, 2) where the carts are,
    `ahead_m` how far the robot's centre of mass lies before its axle. `touched` says whether the
    robot has touched anything.
    """

    def __init__(
        self,
        plan: FloorPlan,
        barrels: int,
        pose: Floats,
        carts: Floats,
        ahead_m: float,
        step_s: float,
    ) -> None:
        self.touched = False
        self._ahead_m, self._step_s = ahead_m, step_s
        self._space = space = pymunk.Space()
        ground, (width, height) = space.static_body, HALL_M
        corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
        shapes: list[pymunk.Shape] = [
            pymunk.Segment(ground, corners[k - 1], corners[k], 0.0) for k in range(4)
        ]
        for x0, y0, x1, y1 in plan.racks.tolist():
            shapes.append(pymunk.Poly(ground, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))
        for x, y, radius in [*plan.pillars.tolist(), *plan.barrels[:barrels].tolist()]:
            shapes.append(pymunk.Circle(ground, radius, (x, y)))
        self._carts = []
        for place in carts.tolist():
            cart = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
            cart.position = place
            self._carts.append(cart)
            shapes.append(pymunk.Circle(cart, CART_RADIUS_M))
        # its mass and inertia count in the wheels' grip alone: nothing pushes it before it touches
        self._robot = robot = pymunk.Body(1.0, 1.0)
        x, y, robot.angle = pose.tolist()
        cosine, sine = math.cos(robot.angle), math.sin(robot.angle)
        robot.position = (x + ahead_m * cosine, y + ahead_m * sine)
        disc = pymunk.Circle(robot, RADIUS_M, (-ahead_m, 0.0))
        disc.collision_type = _ROBOT
        space.add(*shapes, *self._carts, robot, disc)
        space.on_collision(_ROBOT, None, begin=self._touch)

    def _touch(self, *_: Any) -> None:
        self.touched = True

    def move(self, velocities: list[list[float]], carts: list[list[float]]) -> tuple[float, ...]:
        """Keep each velocity of the robot for one step, or until it touches something.

        `velocities` (steps, 3), see `robot.velocities`; `carts` (c, 2) those of carts. Returns the
        new pose.
        """
        robot, step = self._robot, self._space.step
        for cart, velocity in zip(self._carts, carts, strict=True):
            cart.velocity = velocity  # type: ignore[assignment]
        for x, y, turning in velocities:
            robot.velocity = (x, y)
            robot.angular_velocity = turning
            step(self._step_s)
            if self.touched:
                break
        angle, (x, y) = robot.angle, robot.position
        return x - self._ahead_m * math.cos(angle), y - self._ahead_m * math.sin(angle), angle
