"""Drives in lockstep, the episodes of self-driving: cars on routes, their observations, ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.checks import bounded, check_bounds
from sada_gym.envs.driving.camera.pinhole import Lens, Mount, TownCamera
from sada_gym.envs.driving.world.route import COMMANDS, SPACING_M, Route, random_route
from sada_gym.envs.driving.world.town import LANE_WIDTH_M, LAYOUTS, town
from sada_gym.envs.driving.world.vehicle import (
    MAX_ACCELERATION_M_S2,
    MAX_STEERING_RAD,
    WIDTH_M,
    drive,
    locate,
)
from sada_gym.envs.driving.world.weather import NAMES, TRAINING_WEATHERS, weather_index
from sada_gym.envs.episodes.base import Episodes
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes, Floats, Indices

SIMULATION_HZ = 15
POLICY_HZ = 5
"""The frequencies of highway-env's own `racetrack`."""
LANE_TOLERANCE_M = (LANE_WIDTH_M + WIDTH_M) / 2
"""A car whose middle is further than this from its lane's middle has left the lane altogether."""
TOP_SPEED_M_S = 15.0
"""The speed that is observed as 1."""
PICTURE_ROWS, PICTURE_COLUMNS = 44, 100

OBSERVATION_SPACE = spaces.Dict(
    {
        "command": spaces.Box(0.0, 1.0, (len(COMMANDS),), np.float32),
        "image": spaces.Box(0, 255, (PICTURE_ROWS, PICTURE_COLUMNS, 3), np.uint8),
        "speed": spaces.Box(0.0, 1.0, (1,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)


class DrivingEnd(IntEnum):
    """How a drive ended."""

    UNDER_WAY = 0
    ARRIVED = 1
    LEFT_LANE = 2
    TOO_LATE = 3


@dataclass(frozen=True)
class DrivingStart:
    """How one drive begins."""

    route: Route
    mount: Mount
    weather: int  # an index into `LIGHTS`
    seed: int = 0  # the number that fixes the rain
    lateral_m: float = 0.0  # the car's place, to the right of its lane's middle
    turned_rad: float = 0.0  # the angle by which the car is turned to the right
    speed_m_s: float = 0.0


class DrivingEpisodes(Episodes[DrivingStart]):
    """Cars that drive in lockstep.

    Attributes:
        states: (n, 4) x, y, heading, speed.
        progress_m: (n,) along the route.
        lateral_m: (n,) to the right of the lane's middle.
        ending: (n,) int8, of `DrivingEnd`.
    """

    task_id = "SADA-DrivingTask-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, camera: TownCamera, starts: Sequence[DrivingStart]) -> None:
        super().__init__(starts)
        self._camera = camera
        self._lens = Lens(PICTURE_ROWS, PICTURE_COLUMNS)
        count = len(starts)
        self.states = np.zeros((count, 4))
        self.progress_m, self.lateral_m = np.zeros(count), np.zeros(count)
        self.ending = np.zeros(count, np.int8)
        self._at = np.zeros(count, np.int64)
        self._rays, self._rays_of = np.zeros(0, np.float32), np.zeros(count, np.int64)
        self._height, self._weather = np.zeros(count), np.zeros(count, np.int64)
        self._limit = np.zeros(count, np.int64)
        self._pack()
        self._aim()
        for i, start in enumerate(starts):
            self.begin(i, start)

    def begin(self, i: int, start: DrivingStart) -> None:
        """Begin another drive in place i."""
        before, self.starts[i] = self.starts[i], start
        if before.route is not start.route:
            self._pack()
        if before.mount != start.mount:
            self._aim()
        route = start.route
        heading = route.heading[0]
        side = np.array([-np.sin(heading), np.cos(heading)])
        place = route.points[0] + start.lateral_m * side
        self.states[i] = [*place, heading + start.turned_rad, start.speed_m_s]
        self._at[i] = 0
        self.steps[i], self.ending[i] = 0, DrivingEnd.UNDER_WAY
        self.progress_m[i], self.lateral_m[i] = 0.0, start.lateral_m
        self._height[i], self._weather[i] = start.mount.height_m, start.weather
        self._limit[i] = int(np.ceil(route.time_limit_s * POLICY_HZ))

    def under_way(self) -> Indices:
        """Return the drives that have not ended."""
        return np.flatnonzero(self.ending == DrivingEnd.UNDER_WAY)

    @property
    def score(self) -> Floats:
        """The scores, (n,): 1 where a car has arrived, else 0."""
        score: Floats = (self.ending == DrivingEnd.ARRIVED).astype(np.float64)
        return score

    def snapshot(self) -> Batch:
        """Return states and the drivers' commands."""
        everyone = np.arange(len(self))
        return {"states": self.states, "command": self.commands(everyone), "ending": self.ending}

    def where(self, i: int) -> str:
        """Say at which step of which route a car is."""
        return f"step {self.steps[i]} of the route {' '.join(self.starts[i].route.corners)}"

    def commands(self, which: Indices) -> npt.NDArray[np.int8]:
        """Return the commands that the drivers get, indices into `COMMANDS`."""
        commands: npt.NDArray[np.int8] = self._command[self._first[which] + self._at[which]]
        return commands

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some drivers, see `DrivingTaskEnv`."""
        speed = np.clip(self.states[which, 3:] / TOP_SPEED_M_S, 0.0, 1.0)
        return {
            "image": self.render(which),
            "speed": speed.astype(np.float32),
            "command": np.eye(len(COMMANDS), dtype=np.float32)[self.commands(which)],
        }

    def render(self, which: Indices) -> Bytes:
        """Draw what some of the cameras see."""
        poses = np.column_stack([self.states[which, :3], self._height[which]])
        seeds = np.array([self.starts[i].seed for i in which], np.uint64)
        keys = seeds * np.uint64(1 << 20) + self.steps[which].astype(np.uint64)
        return self._camera.draw(
            self._lens, self._rays, self._rays_of[which], poses, self._weather[which], keys
        )

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Let some cars drive one step.

        Actions (n, 2) are clipped to [-1, 1]: steering, positive to the right, and acceleration.
        """
        actions = np.clip(self._validate_actions(which, actions), -1.0, 1.0)
        states = self.states[which]
        drive(
            states,
            MAX_STEERING_RAD * actions[:, 0],
            MAX_ACCELERATION_M_S2 * actions[:, 1],
            1 / SIMULATION_HZ,
            SIMULATION_HZ // POLICY_HZ,
        )
        self.states[which] = states
        first, last = self._first[which], self._last[which]
        at = first + self._at[which]
        along, lateral = locate(states, self._points, self._heading, first, last, at)
        self._at[which] = at - first
        self.steps[which] += 1
        self.progress_m[which] = SPACING_M * (at - first) + along
        self.lateral_m[which] = lateral
        length = SPACING_M * (last - first)
        ending = np.where(self.steps[which] >= self._limit[which], DrivingEnd.TOO_LATE, 0)
        ending = np.where(self.progress_m[which] >= length, DrivingEnd.ARRIVED, ending)
        ending = np.where(np.abs(lateral) > LANE_TOLERANCE_M, DrivingEnd.LEFT_LANE, ending)
        self.ending[which] = ending

    def _pack(self) -> None:
        different = list({id(start.route): start.route for start in self.starts}.values())
        sizes = [len(route.points) for route in different]
        first = dict(zip(map(id, different), np.cumsum([0, *sizes[:-1]]), strict=True))
        self._first = np.array([first[id(start.route)] for start in self.starts], np.int64)
        counts = np.array([len(start.route.points) for start in self.starts])
        self._last = self._first + counts - 1
        self._points = np.concatenate([route.points for route in different])
        self._heading = np.concatenate([route.heading for route in different])
        self._command = np.concatenate([route.command for route in different])

    def _aim(self) -> None:
        pitches = [start.mount.pitch_deg for start in self.starts]
        different = sorted(set(pitches))
        self._rays = np.stack([self._lens.rays(pitch) for pitch in different])
        self._rays_of = np.array([different.index(pitch) for pitch in pitches], np.int64)


@dataclass(frozen=True)
class DriveDistribution:
    """A distribution of drives.

    Attributes:
        layout: The town, `training` or `benchmark`.
        weathers: The names of the weathers that occur.
        height_m: The least and the greatest height of the camera.
        pitch_deg: The least and the greatest pitch of the camera.
        corners: The least and the greatest number of corners and bends that a route passes.
        lateral_m: The greatest distance from its lane's middle at which a car starts.
        turned_deg: The greatest angle by which the car is turned.
        speed_m_s: The greatest speed at which the car starts.
    """

    layout: str = "training"
    weathers: tuple[str, ...] = NAMES[:TRAINING_WEATHERS]
    height_m: tuple[float, float] = bounded(0.5, 5.0, (1.4, 1.4))
    pitch_deg: tuple[float, float] = bounded(-25.0, 25.0, (-15.0, -15.0))
    corners: tuple[int, int] = bounded(1, 20, (1, 4))
    lateral_m: float = bounded(0.0, LANE_WIDTH_M / 2, 0.0)
    turned_deg: float = bounded(0.0, 90.0, 0.0)
    speed_m_s: float = bounded(0.0, TOP_SPEED_M_S, 0.0)

    def __post_init__(self) -> None:
        """Reject unknown names, and cameras from which no image can be drawn."""
        if self.layout not in LAYOUTS:
            raise UserError(f"Expected a layout among {', '.join(LAYOUTS)}, got {self.layout!r}.")
        if isinstance(self.weathers, str) or not self.weathers:
            raise UserError(f"Expected a tuple of weathers' names, got {self.weathers!r}.")
        for name in self.weathers:
            weather_index(name)
        check_bounds(self)

    def draw(self, rng: np.random.Generator) -> DrivingStart:
        """Draw one drive."""
        corners = int(rng.integers(self.corners[0], self.corners[1] + 1))
        route = random_route(town(self.layout), rng, corners)
        mount = Mount(float(rng.uniform(*self.height_m)), float(rng.uniform(*self.pitch_deg)))
        return DrivingStart(
            route=route,
            mount=mount,
            weather=weather_index(self.weathers[rng.integers(len(self.weathers))]),
            seed=int(rng.integers(2**31)),
            lateral_m=float(rng.uniform(-self.lateral_m, self.lateral_m)),
            turned_rad=float(np.deg2rad(rng.uniform(-self.turned_deg, self.turned_deg))),
            speed_m_s=float(rng.uniform(0, self.speed_m_s)),
        )
