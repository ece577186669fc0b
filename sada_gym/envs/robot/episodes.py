"""Trips in lockstep, the episodes of the robot: it drives to goals in a warehouse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.robot.start import GOAL_M, POLICY_HZ, RobotEnd, RobotStart
from sada_gym.envs.robot.world.bodies import Bodies
from sada_gym.envs.robot.world.carts import drive, places_of
from sada_gym.envs.robot.world.floor_plan import BARRELS, CART_RADIUS_M, CARTS, HALL_M
from sada_gym.envs.robot.world.geometry import SPACING_M
from sada_gym.envs.robot.world.lidar import RAYS, SCANS, SECTORS, nearest, scan
from sada_gym.envs.robot.world.robot import axle_to_mass, delayed_rims, velocities
from sada_gym.envs.robot.world.way import STATES, fill_state, locate
from sada_gym.foundations.arrays import Bytes, Floats, Indices

SUBSTEPS = 5
STEP_S = 1 / (POLICY_HZ * SUBSTEPS)
SLOWEST_M_S, GRACE_S = 0.25, 10.0
"""A trip may take as long as its way takes at this speed, and so much longer."""

_FURTHEST = 40.0
"""More than the hall's diagonal in units of the nearest of these points."""

OBSERVATION_SPACE = spaces.Dict(
    {
        "lidar": spaces.Box(0.0, 1.0, (SECTORS,), np.float32),
        "state": spaces.Box(-_FURTHEST, _FURTHEST, (STATES,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)

_HALL = np.array(HALL_M)
_RACKS = 9
"""The greatest number of racks."""
_CIRCLES = 4 + BARRELS + CARTS


class RobotEpisodes(Episodes[RobotStart]):
    """Robots that drive to their goals in lockstep.

    Attributes:
        poses: (n, 3) x, y of the axle's middle in m, heading in rad.
        velocities: (n, 3) of the centre of mass in m/s, and the turning rate in rad/s.
        commands: (n, 5, 2) the last actions, newest first.
        lanes: (n, CARTS, 4) of the carts: x0, y0, x1, y1, the same twice where there is no cart.
        places: (n, CARTS, 2) each cart's share of its lane, and its direction, 1 or -1.
        carts: (n, CARTS, 2) where the carts are.
        points: (n, SCANS, RAYS, 2) where the robot believes the last returns to be, newest first.
        remaining_m: (n,) what is left of the way.
        ending: (n,) int8, of `RobotEnd`.
    """

    task_id = "SADA-RobotTask-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, starts: Sequence[RobotStart]) -> None:
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
        self._bodies: list[Bodies] = [None] * n  # type: ignore[list-item]
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: RobotStart) -> None:
        """Begin another trip in place i."""
        plan, conditions = start.plan, start.conditions
        self.starts[i] = start
        way = plan.ways[start.trip]
        heading = math.atan2(way[3, 1] - way[0, 1], way[3, 0] - way[0, 0]) + start.turned_rad
        self.poses[i], self.velocities[i] = (way[0, 0], way[0, 1], heading), 0.0
        self.remaining_m[i] = SPACING_M * (len(way) - 1)
        self.steps[i], self.ending[i], self._at[i] = 0, RobotEnd.UNDER_WAY, 0
        self._limit[i] = math.ceil((self.remaining_m[i] / SLOWEST_M_S + GRACE_S) * POLICY_HZ)
        # places that stay empty lie far outside of the hall, or have no size
        self._racks[i], self.lanes[i], self._circles[i] = -100.0, -100.0, 0.0
        self._racks[i, : len(plan.racks)] = plan.racks
        barrels = plan.barrels[: conditions.barrels]
        self._circles[i, CARTS : CARTS + len(plan.pillars)] = plan.pillars
        first = CARTS + len(plan.pillars)
        self._circles[i, first : first + len(barrels)] = barrels
        self.lanes[i, : len(plan.lanes)] = plan.lanes
        self.places[i, :, 0], self.places[i, :, 1] = plan.places, 1.0
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
        ahead_m = axle_to_mass(conditions.payload_kg, conditions.payload_offset_m)
        self._bodies[i] = Bodies(
            plan, conditions.barrels, self.poses[i], self.carts[i], ahead_m, STEP_S
        )
        self._scan(np.array([i]))

    def under_way(self) -> Indices:
        """Return the trips that have not ended."""
        return np.flatnonzero(self.ending == RobotEnd.UNDER_WAY)

    @property
    def score(self) -> Floats:
        """The scores, (n,): 1 where a robot has arrived, else 0."""
        score: Floats = (self.ending == RobotEnd.ARRIVED).astype(np.float64)
        return score

    def where(self, i: int) -> str:
        """Say at which step of which trip a robot is."""
        start = self.starts[i]
        return f"step {self.steps[i]} of trip {start.trip} on floor plan {start.plan.number}"

    def snapshot(self) -> Batch:
        """Return poses, carts, what the robot believes to see, and endings."""
        return {name: getattr(self, name) for name in ("poses", "carts", "points", "ending")}

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some robots, see `RobotTaskEnv`."""
        state = np.empty((len(which), STATES), np.float32)
        for row, i in enumerate(which.tolist()):
            way = self.starts[i].plan.ways[self.starts[i].trip]
            fill_state(
                way, self._at[i], self.poses[i], self.velocities[i], self.commands[i], state[row]
            )
        return {"lidar": nearest(self.poses[which], self.points[which]), "state": state}

    def render(self, which: Indices) -> Bytes:
        """Draw the floor plan around each robot, with what its lidar returned."""
        from sada_gym.envs.robot.frame import draw_frame

        seen = (self.poses, self.carts, self.points)
        return np.stack(
            [draw_frame(self.starts[i], *(part[i] for part in seen)) for i in which.tolist()]
        )

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some robots drive one step.

        Actions (n, 2) are clipped to [-1, 1]: the speed, from 0.1 m/s backwards to 0.6 m/s, and the
        turning rate in 1.5 rad/s to the left.
        """
        actions = np.clip(self._validate_actions(which, actions), -1.0, 1.0)
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
        ending = np.where(late, RobotEnd.TOO_LATE, RobotEnd.UNDER_WAY)
        ending = np.where(away < GOAL_M, RobotEnd.ARRIVED, ending)
        touched = np.array([self._bodies[i].touched for i in which.tolist()])
        self.ending[which] = np.where(touched, RobotEnd.COLLIDED, ending)
        for i in which.tolist():
            way = self.starts[i].plan.ways[self.starts[i].trip]
            self._at[i], self.remaining_m[i] = locate(way, self._at[i], self.poses[i])

    def _drive(self, which: Indices) -> None:
        poses, velocity = self.poses[which], self.velocities[which]
        rims = delayed_rims(self.commands[which], self._delay[which], SUBSTEPS)
        worn = self._payload[which], self._friction[which], self._gain[which]
        each = velocities(poses, velocity, *worn, rims, STEP_S).tolist()
        self.velocities[which] = velocity
        places = self.places[which]
        carts = drive(poses, self.lanes[which], places, STEP_S, SUBSTEPS).tolist()
        for row, i in enumerate(which.tolist()):
            self.poses[i] = self._bodies[i].move(each[row], carts[row])
        self.places[which] = places
        self._place_carts(which)

    def _place_carts(self, which: Indices) -> None:
        self.carts[which] = places_of(self.lanes[which], self.places[which])
        self._circles[which, :CARTS, :2] = self.carts[which]

    def _scan(self, which: Indices) -> None:
        noise, lost = np.empty((len(which), RAYS)), np.empty((len(which), RAYS), np.bool_)
        for row, i in enumerate(which.tolist()):
            noise[row] = self._noise[i] * self._rng[i].standard_normal(RAYS)
            lost[row] = self._rng[i].random(RAYS) < self._dropout[i]
        points = self.points[which]
        points[:, 1:] = points[:, :-1].copy()
        new = np.empty((len(which), RAYS, 2))
        around = self._racks[which], self._circles[which]
        scan(self.poses[which], self._mount[which], _HALL, *around, noise, lost, new)
        points[:, 0] = new
        self.points[which] = points
