"""Drives in MetaDrive, one at a time: a car follows a route among others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.metadrive.start import POLICY_HZ, DriveEnd, DriveStart
from sada_gym.envs.metadrive.world.engine import LIDAR_M, OTHERS, RAYS, Engine, engine
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bytes, Floats, Indices

STATES = 19 + 4 * OTHERS
UNFINISHED = 0.9
"""The most that a route counts on which the car did not arrive."""
SLOWEST_M_S, GRACE_S = 15 / 3.6, 5.0
"""A drive may take as long as its route takes at this speed, and so much longer."""
CARS, THINGS = 64, 48
"""The other cars, and the objects on the road, that pictures show."""

OBSERVATION_SPACE = spaces.Dict(
    {
        "lidar": spaces.Box(0.0, 1.0, (RAYS,), np.float32),
        "state": spaces.Box(0.0, 1.0, (STATES,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)

_DELAYS = 7
"""As many commands as the longest latency needs, and one more."""


class DriveEpisodes(Episodes[DriveStart]):
    """One drive; MetaDrive allows no more in a process.

    Attributes:
        world: The number of the world among those that the engine has begun.
        commands: (1, 7, 2) the last actions, newest first.
        reward: (1,) MetaDrive's own reward of the last step.
        done: (1,) the share of the route that is behind the car.
        ending: (1,) int8, of `DriveEnd`.
    """

    task_id = "SADA-DrivingMetaDriveTask-v0"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, starts: Sequence[DriveStart]) -> None:
        if len(starts) != 1:
            raise UserError(
                "Expected one drive at a time, because MetaDrive allows one engine a process, got "
                f"{len(starts)}. Set num_envs=1, or use more processes."
            )
        super().__init__(starts)
        self.commands = np.zeros((1, _DELAYS, 2))
        self.reward, self.done = np.zeros(1), np.zeros(1)
        self.ending = np.zeros(1, np.int8)
        self._observation = np.zeros(STATES + RAYS, np.float32)
        self._limit = 0
        self.begin(0, starts[0])

    def begin(self, i: int, start: DriveStart) -> None:
        """Begin another drive in place i."""
        self._engine: Engine = engine()
        self.world, observation = self._engine.begin(start)
        self.starts[i] = start
        self._rng = np.random.default_rng([start.seed, 1])
        self.steps[i], self.ending[i], self.commands[i] = 0, DriveEnd.UNDER_WAY, 0.0
        self.reward[i], self.done[i] = 0.0, 0.0
        length_m = float(self.car.navigation.total_length)
        self._limit = math.ceil((length_m / SLOWEST_M_S + GRACE_S) * POLICY_HZ)
        self._sense(observation)

    @property
    def env(self) -> Any:
        """The `MetaDriveEnv` of this drive.

        Raises:
            UserError: If another drive has begun in this process.
        """
        if self.world != self._engine.world:
            raise UserError(
                "Expected the drive that began last in this process, because MetaDrive allows one "
                "engine, got an older one. Close an environment before you use the next."
            )
        return self._engine.env

    @property
    def car(self) -> Any:
        """The car that drives, an object of MetaDrive."""
        return self.env.agent

    def under_way(self) -> Indices:
        """Return the drives that have not ended."""
        return np.flatnonzero(self.ending == DriveEnd.UNDER_WAY)

    @property
    def score(self) -> Floats:
        """The share of the route that was done, (1,): 1 on arrival, else at most `UNFINISHED`."""
        arrived = self.ending == DriveEnd.ARRIVED
        score: Floats = np.where(arrived, 1.0, np.clip(self.done, 0.0, UNFINISHED))
        return score

    def observe(self, which: Indices) -> Batch:
        """Return the observation, see `DriveTaskEnv`."""
        seen = np.repeat(self._observation[None], len(which), axis=0)
        return {"lidar": seen[:, STATES:], "state": seen[:, :STATES]}

    def render(self, which: Indices) -> Bytes:
        """Draw the road around the car from above."""
        from sada_gym.envs.metadrive.frame import draw_frame

        now = {key: values[0] for key, values in self.snapshot().items()}
        return np.stack([draw_frame(self.starts[i], now) for i in which.tolist()])

    def step(self, which: Indices, actions: npt.NDArray[Any]) -> None:
        """Drive one step.

        Actions (1, 2) are clipped to [-1, 1]: steering to the left, and throttle or brake.
        """
        actions = np.clip(self._validate_actions(which, actions), -1.0, 1.0)
        self.commands[:, 1:] = self.commands[:, :-1].copy()
        self.commands[:, 0] = actions
        delay = self.starts[0].conditions["latency_s"] * POLICY_HZ
        whole = int(delay)
        older, share = self.commands[0, whole + 1], delay - whole
        command = (1 - share) * self.commands[0, whole] + share * older
        observation, reward, over, _, info = self.env.step(command.tolist())
        self.steps += 1
        self.reward[0], self.done[0] = reward, info["route_completion"]
        ends = {
            DriveEnd.HIT_CAR: info["crash_vehicle"] or info["crash_human"],
            DriveEnd.HIT_OBJECT: info["crash_object"] or info["crash_building"],
            DriveEnd.LEFT_ROAD: info["out_of_road"],
            DriveEnd.ARRIVED: info["arrive_dest"],
            DriveEnd.TOO_LATE: over or self.steps[0] >= self._limit,
        }
        self.ending[0] = next((end for end, is_so in ends.items() if is_so), DriveEnd.UNDER_WAY)
        self._sense(observation)

    def _sense(self, observation: npt.NDArray[np.float32]) -> None:
        conditions = self.starts[0].conditions
        rays = observation[STATES:].astype(np.float64)
        noise = conditions["lidar_noise_m"] / LIDAR_M * self._rng.standard_normal(RAYS)
        lost = self._rng.random(RAYS) < conditions["lidar_dropout"]
        hit = (rays < 1.0) & ~lost
        self._observation = observation.copy()
        self._observation[STATES:] = np.where(hit, np.clip(rays + noise, 0.0, 1.0), 1.0)

    def info(self, i: int) -> dict[str, Any]:
        """Say what has become of drive i."""
        return {
            "ending": DriveEnd(int(self.ending[i])).name.lower(),
            "route_done": round(float(self.done[i]), 4),
            "after_s": float(self.steps[i] / POLICY_HZ),
            "speed_km_h": round(3.6 * float(self.car.last_speed), 2),
        }

    def snapshot(self) -> Batch:
        """Return the car's pose, its speed a step ago, other cars, things on the road, and more."""
        car = self.car
        if not self.starts[0].roads:
            self.starts[0] = replace(self.starts[0], roads=self._engine.roads())
        cars, things = self._engine.around()
        shown = np.full((1, CARS, 5), np.nan)
        on_road = np.full((1, THINGS, 2), np.nan)
        shown[0, : len(cars[:CARS])] = np.reshape(cars[:CARS], (-1, 5))
        on_road[0, : len(things[:THINGS])] = np.reshape(things[:THINGS], (-1, 2))
        pose = np.array([[*car.position, car.heading_theta, 3.6 * car.last_speed]])
        return {
            "pose": pose,
            "cars": shown,
            "things": on_road,
            "rays": self._observation[None, STATES:],
            "done": self.done,
            "ending": self.ending,
        }
