"""Trips in lockstep, the episodes of the robot: it drives to goals in a warehouse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt
import pymunk
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.compiled import kernel
from sada_gym.envs.episodes.base import Array, Episodes, Indices, Pictures
from sada_gym.envs.robot.conditions import NOMINAL, Conditions
from sada_gym.envs.robot.world.floor_plan import (
    BARRELS,
    CART_RADIUS_M,
    CARTS,
    HALL_M,
    FloorPlan,
    floor_plan,
)
from sada_gym.envs.robot.world.geometry import SPACING_M
from sada_gym.envs.robot.world.lidar import RAYS, SCANS, SECTORS, nearest, scan
from sada_gym.envs.robot.world.robot import RADIUS_M, TRACK_M, axle_to_mass, velocities

POLICY_HZ = 5
SUBSTEPS = 5
STEP_S = 1 / (POLICY_HZ * SUBSTEPS)
FORWARD_M_S, BACKWARD_M_S, TURN_RAD_S = 0.6, 0.1, 1.5
"""The greatest speeds that the robot commands."""
GOAL_M = 0.3
"""The goal is reached where the robot's middle is nearer to it than this."""
CART_M_S = 0.25
CART_SEES_M = 0.9
"""A cart stands still while the robot's middle is nearer to its own than this."""
SLOWEST_M_S, GRACE_S = 0.25, 10.0
"""A trip may take as long as its way takes at this speed, and so much longer."""

_AHEAD_M = (0.4, 0.8, 1.2, 2.0)
"""How far ahead on its way the robot is shown a point."""
_FURTHEST = 40.0
"""More than the hall's diagonal in units of the nearest of these points."""
STATES = 2 * len(_AHEAD_M) + 8

OBSERVATION_SPACE = spaces.Dict(
    {
        "lidar": spaces.Box(0.0, 1.0, (SECTORS,), np.float32),
        "state": spaces.Box(-_FURTHEST, _FURTHEST, (STATES,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)

_HALL = np.array(HALL_M)
_ROBOT = 1
_RACKS = 9
"""The greatest number of racks."""
_CIRCLES = 4 + BARRELS + CARTS


class Ending(IntEnum):
    """How a trip ended."""

    UNDER_WAY = 0
    ARRIVED = 1
    COLLIDED = 2
    TOO_LATE = 3


@dataclass(frozen=True)
class Start:
    """How one trip begins.

    Attributes:
        plan: The floor plan.
        trip: Which of the plan's trips it is.
        conditions: The physical conditions.
        seed: Fixes the lidar's noise.
        turned_rad: By how much the robot is turned from its way to the left.
    """

    plan: FloorPlan = field(default_factory=lambda: floor_plan(0))
    trip: int = 0
    conditions: Conditions = NOMINAL
    seed: int = 0
    turned_rad: float = 0.0


class Trips(Episodes[Start]):
    """Robots that drive to their goals in lockstep.

    Args:
        starts: How each trip begins.

    Attributes:
        poses: (n, 3) x, y of the axle's middle in m, heading in rad.
        velocities: (n, 3) of the centre of mass in m/s, and the turning rate in rad/s.
        carts: (n, CARTS, 2) where the carts are.
        points: (n, SCANS, RAYS, 2) where the robot believes the last returns to be, newest first.
        remaining_m: (n,) what is left of the way.
        ending: (n,) int8, of `Ending`.
    """

    task_id = "SADA-RobotTask-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, starts: Sequence[Start]) -> None:
        super().__init__(starts)
        n = len(starts)
        self.poses, self.velocities = np.zeros((n, 3)), np.zeros((n, 3))
        self.carts = np.zeros((n, CARTS, 2))
        self.points = np.full((n, SCANS, RAYS, 2), np.nan)
        self.remaining_m = np.zeros(n)
        self.ending = np.zeros(n, np.int8)
        self._racks, self._circles = np.zeros((n, _RACKS, 4)), np.zeros((n, _CIRCLES, 3))
        self.lanes, self.places = np.zeros((n, CARTS, 4)), np.zeros((n, CARTS, 2))
        self._mount, self._payload = np.zeros((n, 2)), np.zeros((n, 2))
        self._friction, self._gain = np.zeros(n), np.zeros(n)
        self._noise, self._dropout = np.zeros(n), np.zeros(n)
        self._delay, self._limit = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._at = np.zeros(n, np.int64)
        # the last commands, newest first: as many as the longest latency needs, and one more
        self.commands = np.zeros((n, 5, 2))
        self._rng = [np.random.default_rng(0)] * n
        self._bodies: list[_Bodies] = [None] * n  # type: ignore[list-item]
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: Start) -> None:
        """Begin another trip in place i."""
        plan, conditions = start.plan, start.conditions
        self.starts[i] = start
        way = plan.ways[start.trip]
        heading = math.atan2(way[3, 1] - way[0, 1], way[3, 0] - way[0, 0]) + start.turned_rad
        self.poses[i], self.velocities[i] = (way[0, 0], way[0, 1], heading), 0.0
        self.remaining_m[i] = SPACING_M * (len(way) - 1)
        self.steps[i], self.ending[i], self._at[i] = 0, Ending.UNDER_WAY, 0
        self._limit[i] = math.ceil((self.remaining_m[i] / SLOWEST_M_S + GRACE_S) * POLICY_HZ)
        self._racks[i], self._circles[i] = 0.0, 0.0
        # places that stay empty lie far outside of the hall
        self._racks[i] = -100.0
        self._racks[i, : len(plan.racks)] = plan.racks
        barrels = plan.barrels[: conditions.barrels]
        self._circles[i, CARTS : CARTS + len(plan.pillars)] = plan.pillars
        first = CARTS + len(plan.pillars)
        self._circles[i, first : first + len(barrels)] = barrels
        self.lanes[i] = -100.0
        self.lanes[i, : len(plan.lanes)] = plan.lanes
        self.places[i] = 0.0
        self.places[i, :, 0] = plan.places
        self.places[i, :, 1] = 1.0
        self._circles[i, : len(plan.lanes), 2] = CART_RADIUS_M
        self._mount[i] = math.radians(conditions.lidar_yaw_deg), conditions.lidar_offset_m
        self._payload[i] = conditions.payload_kg, conditions.payload_offset_m
        self._friction[i], self._gain[i] = conditions.floor_friction, conditions.wheel_gain
        self._noise[i], self._dropout[i] = conditions.lidar_noise_m, conditions.lidar_dropout
        self._delay[i] = round(conditions.latency_s / STEP_S)
        self.commands[i] = 0.0
        self._rng[i] = np.random.default_rng(start.seed)
        self.points[i] = np.nan
        self._place_carts(np.array([i]))
        self._bodies[i] = _Bodies(start, self.poses[i], self.carts[i])
        self._scan(np.array([i]))

    def under_way(self) -> Indices:
        """Give the trips that have not ended."""
        return np.flatnonzero(self.ending == Ending.UNDER_WAY)

    @property
    def score(self) -> Array:
        """The scores, (n,): 1 where a robot has arrived, else 0."""
        score: Array = (self.ending == Ending.ARRIVED).astype(np.float64)
        return score

    def where(self, i: int) -> str:
        """Say at which step of which trip a robot is."""
        start = self.starts[i]
        return f"step {self.steps[i]} of trip {start.trip} on floor plan {start.plan.number}"

    def moment(self) -> Batch:
        """Give poses, carts, what the robot believes to see, and endings."""
        return {
            "poses": self.poses,
            "carts": self.carts,
            "points": self.points,
            "ending": self.ending,
        }

    def observe(self, which: Indices) -> Batch:
        """Give the observations of some robots, see `RobotTaskEnv`."""
        state = np.empty((len(which), STATES), np.float32)
        for row, i in enumerate(which.tolist()):
            way = self.starts[i].plan.ways[self.starts[i].trip]
            _fill_state(
                way, self._at[i], self.poses[i], self.velocities[i], self.commands[i], state[row]
            )
        return {"lidar": nearest(self.poses[which], self.points[which]), "state": state}

    def render(self, which: Indices) -> Pictures:
        """Draw the floor plan around each robot, with what its lidar returned."""
        from sada_gym.envs.robot.pictures import frame

        return np.stack([frame(self, i) for i in which.tolist()])

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some robots drive one step.

        Args:
            which: (n,) indices of these robots.
            actions: (n, 2), clipped to [-1, 1]: the speed, from 0.1 m/s backwards to 0.6 m/s, and
                the turning rate in 1.5 rad/s to the left.

        Raises:
            UserError: If the actions are of another shape or not finite.
        """
        actions = np.clip(self._checked(which, actions), -1.0, 1.0)
        commands = self.commands[which]
        commands[:, 1:] = commands[:, :-1].copy()
        commands[:, 0] = actions
        self.commands[which] = commands
        self._drive(which)
        self.steps[which] += 1
        self._scan(which)
        late = self.steps[which] >= self._limit[which]
        goals = np.array([self.starts[i].plan.ways[self.starts[i].trip][-1] for i in which])
        away = np.hypot(*(self.poses[which, :2] - goals).T)
        ending = np.where(late, Ending.TOO_LATE, Ending.UNDER_WAY)
        ending = np.where(away < GOAL_M, Ending.ARRIVED, ending)
        touched = np.array([self._bodies[i].touched for i in which.tolist()])
        self.ending[which] = np.where(touched, Ending.COLLIDED, ending)
        for row, i in enumerate(which.tolist()):
            way = self.starts[i].plan.ways[self.starts[i].trip]
            self._at[i], self.remaining_m[i] = _locate(way, self._at[i], self.poses[i])
            if ending[row] or touched[row]:
                self._bodies[i].remove()

    def _drive(self, which: Indices) -> None:
        poses, velocity = self.poses[which], self.velocities[which]
        rims = _rims(self.commands[which], self._delay[which])
        each = velocities(
            poses,
            velocity,
            self._payload[which],
            self._friction[which],
            self._gain[which],
            rims,
            STEP_S,
        ).tolist()
        self.velocities[which] = velocity
        going = _move_carts(poses, self.lanes[which], self.carts[which])
        going *= CART_M_S
        cart = self.places[which]
        speeds = _cart_speeds(cart, self.lanes[which], going).tolist()
        for row, i in enumerate(which.tolist()):
            self.poses[i] = self._bodies[i].move(each[row], speeds[row])
        _advance_carts(cart, self.lanes[which], going)
        self.places[which] = cart
        self._place_carts(which)

    def _place_carts(self, which: Indices) -> None:
        lane, share = self.lanes[which], self.places[which, :, :1]
        self.carts[which] = lane[..., :2] + share * (lane[..., 2:] - lane[..., :2])
        for row, i in enumerate(which.tolist()):
            self._circles[i, :CARTS, :2] = self.carts[which[row]]

    def _scan(self, which: Indices) -> None:
        noise, lost = np.empty((len(which), RAYS)), np.empty((len(which), RAYS), np.bool_)
        for row, i in enumerate(which.tolist()):
            noise[row] = self._noise[i] * self._rng[i].standard_normal(RAYS)
            lost[row] = self._rng[i].random(RAYS) < self._dropout[i]
        points = self.points[which]
        points[:, 1:] = points[:, :-1].copy()
        new = np.empty((len(which), RAYS, 2))
        scan(
            self.poses[which],
            self._mount[which],
            _HALL,
            self._racks[which],
            self._circles[which],
            noise,
            lost,
            new,
        )
        points[:, 0] = new
        self.points[which] = points


class _Bodies:
    """The rigid bodies of one trip, in a pymunk space: the robot, the carts, and all that stands.

    The wheels' grip decides the robot's velocity; pymunk integrates it and finds the first contact.
    """

    def __init__(self, start: Start, pose: Array, carts: Array) -> None:
        plan, conditions = start.plan, start.conditions
        self.touched = False
        self._space = space = pymunk.Space()
        self._ahead = axle_to_mass(conditions.payload_kg, conditions.payload_offset_m)
        ground, (width, height) = space.static_body, HALL_M
        corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
        shapes: list[pymunk.Shape] = [
            pymunk.Segment(ground, corners[k - 1], corners[k], 0.0) for k in range(4)
        ]
        for x0, y0, x1, y1 in plan.racks.tolist():
            shapes.append(pymunk.Poly(ground, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))
        for x, y, radius in [*plan.pillars.tolist(), *plan.barrels[: conditions.barrels].tolist()]:
            shapes.append(pymunk.Circle(ground, radius, (x, y)))
        self._carts = []
        for place in carts.tolist():
            cart = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
            cart.position = place
            self._carts.append(cart)
            shapes.append(pymunk.Circle(cart, CART_RADIUS_M))
        self._robot = robot = pymunk.Body(1.0, 1.0)
        x, y, robot.angle = pose.tolist()
        robot.position = (
            x + self._ahead * math.cos(robot.angle),
            y + self._ahead * math.sin(robot.angle),
        )
        disc = pymunk.Circle(robot, RADIUS_M, (-self._ahead, 0.0))
        disc.collision_type = _ROBOT
        space.add(*shapes, *self._carts, robot, disc)
        space.on_collision(_ROBOT, None, begin=self._touch)

    def _touch(self, *_: Any) -> None:
        self.touched = True

    def move(self, velocities: list[list[float]], carts: list[list[float]]) -> tuple[float, ...]:
        """Keep each velocity of the robot for one step, and give its new pose."""
        robot, step = self._robot, self._space.step
        for cart, velocity in zip(self._carts, carts, strict=True):
            cart.velocity = velocity  # type: ignore[assignment]
        for x, y, turning in velocities:
            robot.velocity = (x, y)
            robot.angular_velocity = turning
            step(STEP_S)
            if self.touched:
                break
        angle, (x, y) = robot.angle, robot.position
        return x - self._ahead * math.cos(angle), y - self._ahead * math.sin(angle), angle

    def remove(self) -> None:
        """Free the space: a reference from it to this object would keep both for long."""
        self._space.on_collision(_ROBOT, None, begin=None)


@kernel
def _rims(commands: Array, delays: npt.NDArray[np.int64]) -> Array:
    """Give the speeds of the rims over the steps, (n, SUBSTEPS, 2), of commands (n, 5, 2)."""
    rims = np.empty((len(commands), SUBSTEPS, 2))
    for i in range(len(commands)):
        for k in range(SUBSTEPS):
            late = -((k - delays[i]) // SUBSTEPS)
            pedal, wheel = commands[i, late, 0], commands[i, late, 1]
            speed = pedal * FORWARD_M_S if pedal > 0 else pedal * BACKWARD_M_S
            turn = wheel * TURN_RAD_S * TRACK_M
            rims[i, k, 0], rims[i, k, 1] = speed - turn, speed + turn
    return rims


@kernel
def _move_carts(poses: Array, lanes: Array, carts: Array) -> Array:
    """Say which carts drive, 1, and which wait for the robot, 0: (n, CARTS)."""
    going = np.ones((len(poses), CARTS))
    for i in range(len(poses)):
        for k in range(CARTS):
            dx, dy = carts[i, k, 0] - poses[i, 0], carts[i, k, 1] - poses[i, 1]
            if lanes[i, k, 0] < 0.0 or dx * dx + dy * dy < CART_SEES_M * CART_SEES_M:
                going[i, k] = 0.0
    return going


@kernel
def _cart_speeds(carts: Array, lanes: Array, speed: Array) -> Array:
    """Give the velocities of carts, (n, CARTS, 2): carts (n, CARTS, 2) hold place and direction."""
    velocity = np.zeros((len(carts), CARTS, 2))
    for i in range(len(carts)):
        for k in range(CARTS):
            dx, dy = lanes[i, k, 2] - lanes[i, k, 0], lanes[i, k, 3] - lanes[i, k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                pace = carts[i, k, 1] * speed[i, k] / length
                velocity[i, k, 0], velocity[i, k, 1] = pace * dx, pace * dy
    return velocity


@kernel
def _advance_carts(carts: Array, lanes: Array, speed: Array) -> None:
    """Move carts one step along their lanes, and turn them back at the ends."""
    for i in range(len(carts)):
        for k in range(CARTS):
            dx, dy = lanes[i, k, 2] - lanes[i, k, 0], lanes[i, k, 3] - lanes[i, k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                carts[i, k, 0] += carts[i, k, 1] * speed[i, k] * STEP_S * SUBSTEPS / length
            if carts[i, k, 0] >= 1.0:
                carts[i, k, 1] = -1.0
            elif carts[i, k, 0] <= 0.0:
                carts[i, k, 1] = 1.0


@kernel
def _locate(way: Array, at: int, pose: Array) -> tuple[int, float]:
    """Find the way's point that is nearest to the robot, near the last one, and what is left."""
    best, least = at, math.inf
    for k in range(max(0, at - 5), min(len(way), at + 15)):
        squared = (way[k, 0] - pose[0]) ** 2 + (way[k, 1] - pose[1]) ** 2
        if squared < least:
            best, least = k, squared
    k = min(max(best, 1), len(way) - 1)
    dx, dy = way[k, 0] - way[k - 1, 0], way[k, 1] - way[k - 1, 1]
    along = (dx * (pose[0] - way[k, 0]) + dy * (pose[1] - way[k, 1])) / math.sqrt(dx * dx + dy * dy)
    along = min(SPACING_M, max(-SPACING_M, along))
    return best, SPACING_M * (len(way) - 1 - k) - along


@kernel
def _fill_state(
    way: Array,
    at: int,
    pose: Array,
    velocity: Array,
    commands: Array,
    state: npt.NDArray[np.float32],
) -> None:
    """Fill one row of the observation `state`, see `RobotTaskEnv`."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(_AHEAD_M)):
        point = way[min(len(way) - 1, at + round(_AHEAD_M[k] / SPACING_M))]
        dx, dy = point[0] - pose[0], point[1] - pose[1]
        state[2 * k] = (dx * cosine + dy * sine) / _AHEAD_M[k]
        state[2 * k + 1] = (-dx * sine + dy * cosine) / _AHEAD_M[k]
    k = 2 * len(_AHEAD_M)
    state[k] = min(1.0, SPACING_M * (len(way) - 1 - at) / 3.0)
    state[k + 1] = (velocity[0] * cosine + velocity[1] * sine) / FORWARD_M_S
    state[k + 2] = (-velocity[0] * sine + velocity[1] * cosine) / FORWARD_M_S
    state[k + 3] = velocity[2] / TURN_RAD_S
    for j in range(2):
        state[k + 4 + 2 * j] = commands[j, 0]
        state[k + 5 + 2 * j] = commands[j, 1]
