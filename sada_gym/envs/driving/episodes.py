"""Drives in lockstep, the episodes of self-driving: cars on routes, their observations, ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from sada_gym.envs.driving.camera.pinhole import Camera, Lens, Mount, Pictures
from sada_gym.envs.driving.world.route import COMMANDS, SPACING_M, Route
from sada_gym.envs.driving.world.town import LANE_WIDTH_M
from sada_gym.envs.driving.world.vehicle import (
    MAX_ACCELERATION_M_S2,
    MAX_STEERING_RAD,
    WIDTH_M,
    drive,
    locate,
)

SIMULATION_HZ = 15
POLICY_HZ = 5
"""The frequencies of highway-env's own `racetrack`."""
LANE_TOLERANCE_M = (LANE_WIDTH_M + WIDTH_M) / 2
"""A car whose middle is further from its lane's has left the lane with every part."""
TOP_SPEED_M_S = 15.0
"""What the observed speed is divided by."""
PICTURE_ROWS, PICTURE_COLUMNS = 44, 100

Array = npt.NDArray[np.float64]
Observation = dict[str, npt.NDArray[np.generic]]
"""`image` (n, rows, columns, 3) uint8; `speed` (n, 1) and `command` (n, 4), float32 in [0, 1]."""


class Ending(IntEnum):
    """How a drive ended."""

    UNDER_WAY = 0
    ARRIVED = 1
    LEFT_LANE = 2
    TOO_LATE = 3


@dataclass(frozen=True)
class Start:
    """How one drive begins.

    Attributes:
        route: Where to drive.
        mount: The camera's.
        weather: Index into `WEATHERS`.
        seed: Fixes the rain.
        lateral_m: Where the car starts, to the right of its lane's middle.
        turned_rad: By how much it is turned to the right.
        speed_m_s: How fast it is.
    """

    route: Route
    mount: Mount
    weather: int
    seed: int = 0
    lateral_m: float = 0.0
    turned_rad: float = 0.0
    speed_m_s: float = 0.0


class Drives:
    """Cars that drive in lockstep.

    Args:
        camera: Of the town.
        starts: One a drive.

    Attributes:
        states: (n, 4) x, y, heading, speed.
        steps: (n,) int64, steps driven.
        progress_m: (n,) along the route.
        lateral_m: (n,) to the right of the lane's middle.
        ending: (n,) int8, of `Ending`.
    """

    def __init__(self, camera: Camera, starts: Sequence[Start]) -> None:
        self._camera = camera
        self._lens = Lens(PICTURE_ROWS, PICTURE_COLUMNS)
        count = len(starts)
        self.starts: list[Start] = [*starts]
        self.states = np.zeros((count, 4))
        self.steps = np.zeros(count, np.int64)
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

    def __len__(self) -> int:
        """Number of drives."""
        return len(self.starts)

    def begin(self, i: int, start: Start) -> None:
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
        self.steps[i], self.ending[i] = 0, Ending.UNDER_WAY
        self.progress_m[i], self.lateral_m[i] = 0.0, start.lateral_m
        self._height[i], self._weather[i] = start.mount.height_m, start.weather
        self._limit[i] = int(np.ceil(route.time_limit_s * POLICY_HZ))

    def under_way(self) -> npt.NDArray[np.intp]:
        """Which drives have not ended."""
        return np.flatnonzero(self.ending == Ending.UNDER_WAY)

    def commands(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.int8]:
        """The commands that the drivers get, indices into `COMMANDS`."""
        commands: npt.NDArray[np.int8] = self._command[self._first[which] + self._at[which]]
        return commands

    def observe(self, which: npt.NDArray[np.intp]) -> Observation:
        """Observations of some of the drivers."""
        speed = np.clip(self.states[which, 3:] / TOP_SPEED_M_S, 0.0, 1.0)
        return {
            "image": self.render(which),
            "speed": speed.astype(np.float32),
            "command": np.eye(len(COMMANDS), dtype=np.float32)[self.commands(which)],
        }

    def render(self, which: npt.NDArray[np.intp]) -> Pictures:
        """Images of some of the cameras."""
        poses = np.column_stack([self.states[which, :3], self._height[which]])
        seeds = np.array([self.starts[i].seed for i in which], np.uint64)
        keys = seeds * np.uint64(1 << 20) + self.steps[which].astype(np.uint64)
        return self._camera.draw(
            self._lens, self._rays, self._rays_of[which], poses, self._weather[which], keys
        )

    def step(self, which: npt.NDArray[np.intp], actions: Array) -> None:
        """Let some cars drive one step.

        Args:
            which: (n,) those.
            actions: (n, 2) in [-1, 1]: steering, positive to the right, and acceleration.
        """
        actions = np.asarray(actions, np.float64)
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
        ending = np.where(self.steps[which] >= self._limit[which], Ending.TOO_LATE, 0)
        ending = np.where(self.progress_m[which] >= length, Ending.ARRIVED, ending)
        ending = np.where(np.abs(lateral) > LANE_TOLERANCE_M, Ending.LEFT_LANE, ending)
        self.ending[which] = ending

    def _pack(self) -> None:
        """Lay the routes' points behind one another."""
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
        """Work out the rays of each pitch that occurs."""
        pitches = [start.mount.pitch_deg for start in self.starts]
        different = sorted(set(pitches))
        self._rays = np.stack([self._lens.rays(pitch) for pitch in different])
        self._rays_of = np.array([different.index(pitch) for pitch in pitches], np.int64)


@dataclass(frozen=True)
class Rollout:
    """Drives as they were driven, step by step.

    Attributes:
        starts: How each began.
        states: For each, (steps + 1, 4) x, y, heading and speed before every step, and at the end.
        commands: For each, (steps + 1,) the driver's command then.
        endings: How each ended.
    """

    starts: tuple[Start, ...]
    states: tuple[Array, ...]
    commands: tuple[npt.NDArray[np.int8], ...]
    endings: tuple[Ending, ...]

    @property
    def score(self) -> float:
        """The share of arrivals."""
        return float(np.mean([ending == Ending.ARRIVED for ending in self.endings]))


OnStep = Callable[[Drives], None]
"""What is called before every step."""


def record(drives: Drives, run: Callable[[Drives, OnStep], None]) -> Rollout:
    """Let cars drive to their ends, and keep every step.

    Args:
        drives: The cars.
        run: Lets them drive, and calls what it is given before every step.
    """
    everyone = np.arange(len(drives))
    states: list[Array] = []
    commands: list[npt.NDArray[np.int8]] = []

    def keep(drives: Drives) -> None:
        states.append(drives.states.copy())
        commands.append(drives.commands(everyone))

    run(drives, keep)
    keep(drives)
    lasted = (drives.steps + 1).tolist()
    return Rollout(
        starts=tuple(drives.starts),
        states=tuple(np.array(states[:count])[:, i] for i, count in enumerate(lasted)),
        commands=tuple(np.array(commands[:count])[:, i] for i, count in enumerate(lasted)),
        endings=tuple(Ending(int(code)) for code in drives.ending),
    )
