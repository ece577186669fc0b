"""One drive in CARLA: a car with a camera on a route, tick by tick."""

from __future__ import annotations

import queue
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch
from sada_gym.envs.carla.connection import STEP_S, ServerWorld
from sada_gym.envs.carla.routes import COMMANDS, STEP_M, TownRoute
from sada_gym.envs.episodes.base import Episodes
from sada_gym.errors import InvalidWorld, UserError
from sada_gym.foundations.arrays import Bytes, Floats, Indices

PICTURE_ROWS, PICTURE_COLUMNS = 88, 200
OBSERVATION_SPACE = spaces.Dict(
    {
        "command": spaces.Box(0.0, 1.0, (len(COMMANDS),), np.float32),
        "image": spaces.Box(0, 255, (PICTURE_ROWS, PICTURE_COLUMNS, 3), np.uint8),
        "speed": spaces.Box(0.0, 100.0, (1,), np.float32),
    }
)
ACTION_SPACE: spaces.Box[Any] = spaces.Box(-1.0, 1.0, (2,), np.float32)

ARRIVED, LEFT_ROUTE, TOO_LATE = "arrived", "left_route", "too_late"
_CAR = "vehicle.tesla.model3"
_FIELD_OF_VIEW_DEG = 100.0
_CAMERA_AHEAD_M = 2.0  # where conditional imitation learning had it
_SPAWN_HEIGHTS_M = (0.3, 0.6, 1.0)
_SETTLING_TICKS = 10
_SLOWEST_M_S = 10 / 3.6  # in time is 10 km/h, as in CARLA's first benchmark
_GOAL_M = 4.0
_OFF_ROUTE_M = 8.0
_SEEN_AHEAD = 15  # points of the route among which the car is looked for
_FRAME_S = 2.0
_MAX_LOST_FRAMES = 10


@dataclass(frozen=True)
class DriveStart:
    """How a drive begins: its route, and the camera's mount in m above the ground and degrees."""

    route: TownRoute
    camera_height_m: float
    camera_pitch_deg: float


class Drive(Episodes[DriveStart]):
    """A car on a route, as `Episodes` of one; `close` takes car and camera off the server.

    A drive ends in one of three ways, `ending`: it arrived, left its route by 8 m, or was slower
    than 10 km/h in the mean.

    Raises:
        InvalidWorld: If the server refuses the car, or loses frames of the camera.
        ServerLost: If it stops to answer.
    """

    task_id = "a driving task in CARLA"
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, opened: ServerWorld, start: DriveStart) -> None:
        super().__init__([start])
        self._session = opened
        self._frames: queue.Queue[Any] = queue.Queue()
        self._at = self._lost = 0
        self._autopilot = False
        self.ending = ""
        self.begin(0, start)

    def begin(self, i: int, start: DriveStart) -> None:  # noqa: ARG002
        """Spawn the car and its camera, and let the car come to rest."""
        carla, world = self._session.carla, self._session.world
        with self._session.answering():
            blueprints = world.get_blueprint_library()
            self._car = self._spawned_car(blueprints.find(_CAR), start.route)
            camera = blueprints.find("sensor.camera.rgb")
            for key, value in (
                ("image_size_x", PICTURE_COLUMNS),
                ("image_size_y", PICTURE_ROWS),
                ("fov", _FIELD_OF_VIEW_DEG),
            ):
                camera.set_attribute(key, str(value))
            mount = carla.Transform(
                carla.Location(x=_CAMERA_AHEAD_M, z=start.camera_height_m),
                carla.Rotation(pitch=start.camera_pitch_deg),
            )
            sensor = world.spawn_actor(camera, mount, attach_to=self._car)
            self._session.actors.append(sensor)
            sensor.listen(self._frames.put)
            self._car.apply_control(carla.VehicleControl(brake=1.0))
            for _ in range(_SETTLING_TICKS):
                world.tick()
        self._tick()

    def _spawned_car(self, blueprint: Any, route: TownRoute) -> Any:
        carla = self._session.carla
        x, y, z, yaw = route.start
        for height in _SPAWN_HEIGHTS_M:
            at = carla.Transform(carla.Location(x, y, z + height), carla.Rotation(yaw=yaw))
            car = self._session.world.try_spawn_actor(blueprint, at)
            if car is not None:
                self._session.actors.append(car)
                return car
        reason = f"the server refused a car at x = {x:.1f} m, y = {y:.1f} m"
        raise InvalidWorld(f"Expected a free place for the car, but {reason}.", reason)

    def hand_over(self) -> None:
        """Let the traffic manager drive along the route from now on."""
        if not self._autopilot:
            self._autopilot = True
            carla, traffic = self._session.carla, self._session.traffic
            ahead = self.starts[0].route.points_m[1:].tolist()
            with self._session.answering():
                self._car.set_autopilot(True, traffic.get_port())
                traffic.ignore_lights_percentage(self._car, 100.0)
                traffic.set_path(self._car, [carla.Location(x, y, 0.0) for x, y in ahead])

    def under_way(self) -> Indices:
        """Return the drive, unless it has ended."""
        return np.arange(0 if self.ending else 1)

    @property
    def score(self) -> Floats:
        """1 if the car arrived, else 0, (1,)."""
        return np.array([float(self.ending == ARRIVED)])

    @property
    def progress(self) -> float:
        """The share of the route that lies behind the car."""
        if self.ending == ARRIVED:
            return 1.0
        return self._at / (len(self.starts[0].route.points_m) - 1)

    def observation(self, i: int) -> dict[str, npt.NDArray[Any]]:  # noqa: ARG002
        """Return what the driver sees."""
        command = np.zeros(len(COMMANDS), np.float32)
        command[self.starts[0].route.commands[self._at]] = 1.0
        speed = np.array([min(self._speed_m_s, 100.0)], np.float32)
        return {"command": command, "image": self._image.copy(), "speed": speed}

    def observe(self, which: Indices) -> Batch:
        """Return the observation as a batch."""
        return {key: np.stack([value] * len(which)) for key, value in self.observation(0).items()}

    def render(self, which: Indices) -> Bytes:
        """Return the camera's image, (1, rows, columns, 3)."""
        return np.stack([self._image] * len(which))

    def snapshot(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the camera's image, which is all that a replay shows."""
        return {"image": self._image[None].copy()}

    def step(self, which: Indices, actions: Any) -> None:
        """Take (steer, acceleration) or (steer, throttle, brake), clipped to their ranges.

        Raises:
            UserError: If the actions have another shape, or are not finite.
        """
        given = np.asarray(actions, np.float64)
        if given.shape not in ((len(which), 2), (len(which), 3)) or not np.isfinite(given).all():
            raise UserError(
                "Expected (steer, acceleration) or (steer, throttle, brake) as finite numbers, got "
                f"{given.tolist()} at {self.where(0)}. Fix the driver."
            )
        steer, *others = given[0].tolist()
        throttle, brake = others if len(others) == 2 else (others[0], -others[0])
        if not self._autopilot:
            with self._session.answering():
                self._car.apply_control(
                    self._session.carla.VehicleControl(
                        throttle=min(max(throttle, 0.0), 1.0),
                        steer=min(max(steer, -1.0), 1.0),
                        brake=min(max(brake, 0.0), 1.0),
                    )
                )
        self._tick()
        self.steps += 1
        self._end()

    def _tick(self) -> None:
        """Go on by a tick, and wait for the camera's frame of it."""
        with self._session.answering():
            wanted = self._session.world.tick()
            image = self._frame(wanted)
            while image is None:
                self._lost += 1
                if self._lost > _MAX_LOST_FRAMES:
                    reason = f"the camera lost more than {_MAX_LOST_FRAMES} frames"
                    raise InvalidWorld(
                        f"Expected a camera's frame each tick, but {reason}.", reason
                    )
                wanted = self._session.world.tick()
                image = self._frame(wanted)
            shape = (image.height, image.width, 4)
            self._image = np.frombuffer(image.raw_data, np.uint8).reshape(shape)[..., 2::-1].copy()
            velocity, place = self._car.get_velocity(), self._car.get_location()
        self._speed_m_s = float(np.hypot(velocity.x, velocity.y))
        self._place_m = np.array([place.x, place.y])

    def _frame(self, wanted: int) -> Any:
        """Return the camera's frame of a tick; None if it did not come."""
        while True:
            try:
                image = self._frames.get(timeout=_FRAME_S)
            except queue.Empty:
                return None
            if image.frame == wanted:
                return image
            if image.frame > wanted:
                return None

    def _end(self) -> None:
        route = self.starts[0].route
        ahead = route.points_m[self._at : self._at + _SEEN_AHEAD]
        distances_m = np.hypot(*(ahead - self._place_m).T)
        self._at += int(distances_m.argmin())
        goal_m = float(np.hypot(*(route.points_m[-1] - self._place_m)))
        # behind the last point the car may be nearer to it than to the goal's circle
        if goal_m < _GOAL_M and self._at * STEP_M > route.length_m - 2 * _GOAL_M:
            self.ending = ARRIVED
        elif distances_m.min() > _OFF_ROUTE_M:
            self.ending = LEFT_ROUTE
        elif int(self.steps[0]) * STEP_S > route.length_m / _SLOWEST_M_S:
            self.ending = TOO_LATE

    def close(self) -> None:
        """Take car and camera off the server."""
        with self._session.answering():
            self._session.destroy()
