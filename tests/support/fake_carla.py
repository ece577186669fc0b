"""A CARLA server within this process: a small town, simple cars and cameras over CARLA's types."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from functools import cache
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as Xml

import carla
import numpy as np

VERSION = "0.9.16"
JUNCTIONS_M, MOUTH_M, ROAD_M, LANE_M = (0.0, 80.0, 160.0), 10.0, 60.0, 3.5
WHEELBASE_M, MAX_STEER_RAD, ACCELERATION_M_S2, BRAKING_M_S2 = 2.9, 0.6, 4.0, 8.0
SPEED_M_S = 8.0
SERVERS: dict[int, FakeServer] = {}
"""The servers that run, by port."""


def start(port: int = 2000, **faults: Any) -> FakeServer:
    """Start a server, and let `carla.Client` reach this one instead of real ones."""
    carla.Client = Client
    SERVERS[port] = FakeServer(**faults)
    return SERVERS[port]


def start_as_told(told: dict[str, Any]) -> None:
    """Start a server on each of `ports`, with a town of one route."""
    from sada_gym.envs.carla import application, routes

    application.ROUTES = routes.ROUTES = 1
    for port in told.pop("ports", [2000]):
        start(port, **told)


@dataclass
class FakeServer:
    """A server's state, and what goes wrong on it."""

    version: str = VERSION
    refuses_spawns: bool = False
    drops_every: int = 0  # of the camera's frames; 1 drops all
    dies_at_tick: int = 0
    interrupts_at_tick: int = 0
    exits_at_tick: int = 0
    log: str = ""  # a file that gets a line for each world that is loaded: the port and the process
    map_name: str = "Town10HD_Opt"
    actors: list[Any] = field(default_factory=list)
    ticks: int = 0
    worlds: int = 0
    settings: Any = field(default_factory=carla.WorldSettings)
    weather: Any = carla.WeatherParameters.CloudyNoon
    seeds: list[tuple[str, int]] = field(default_factory=list)
    traffic_synchronous: bool = False

    def check(self) -> None:
        if self.dies_at_tick and self.ticks >= self.dies_at_tick:
            raise RuntimeError("time-out of 120000ms while waiting for the simulator")


class Client:
    def __init__(self, host: str, port: int) -> None:
        self._place, self._port, self._timeout_s = f"{host}:{port}", port, 5.0

    @property
    def _server(self) -> FakeServer:
        if self._port not in SERVERS:
            raise RuntimeError(f"time-out while waiting for the simulator at {self._place}")
        SERVERS[self._port].check()
        return SERVERS[self._port]

    def set_timeout(self, seconds: float) -> None:
        self._timeout_s = seconds

    def get_client_version(self) -> str:
        return VERSION

    def get_server_version(self) -> str:
        return self._server.version

    def get_available_maps(self) -> list[str]:
        assert self._server
        return ["/Game/Carla/Maps/Town01", "/Game/Carla/Maps/Town10HD_Opt"]

    def get_world(self) -> World:
        return World(self._server)

    def load_world(self, name: str) -> World:
        server = self._server
        server.map_name = name
        server.actors.clear()
        server.settings = carla.WorldSettings()
        server.worlds += 1
        if server.log:
            with open(server.log, "a", encoding="utf-8") as log:
                log.write(f"{self._port} {os.getpid()}\n")
        return World(server)

    def get_trafficmanager(self, port: int) -> TrafficManager:
        return TrafficManager(self._server, port)


class World:
    def __init__(self, server: FakeServer) -> None:
        self._server = server

    def get_settings(self) -> Any:
        self._server.check()
        return _copied(self._server.settings, carla.WorldSettings())

    def apply_settings(self, settings: Any) -> int:
        self._server.check()
        assert isinstance(settings, carla.WorldSettings)
        self._server.settings = _copied(settings, carla.WorldSettings())
        return self._server.ticks

    def get_weather(self) -> Any:
        return _copied(self._server.weather, carla.WeatherParameters())

    def set_weather(self, weather: Any) -> None:
        self._server.check()
        assert isinstance(weather, carla.WeatherParameters)
        self._server.weather = _copied(weather, carla.WeatherParameters())

    def get_map(self) -> Any:
        return town()

    def set_pedestrians_seed(self, seed: int) -> None:
        self._server.seeds.append(("pedestrians", seed))

    def get_blueprint_library(self) -> Any:
        return SimpleNamespace(find=Blueprint)

    def try_spawn_actor(self, blueprint: Blueprint, at: Any) -> Car | None:
        self._server.check()
        assert blueprint.id.startswith("vehicle.")
        return None if self._server.refuses_spawns else Car(self._server, at)

    def spawn_actor(self, blueprint: Blueprint, at: Any, attach_to: Car) -> Camera:
        self._server.check()
        return Camera(self._server, blueprint.attributes, at, attach_to)

    def tick(self) -> int:
        server = self._server
        assert server.settings.synchronous_mode
        server.ticks += 1
        if server.ticks == server.interrupts_at_tick:
            raise KeyboardInterrupt
        if server.ticks == server.exits_at_tick:
            os._exit(9)
        server.check()
        for kind in (Car, Camera):
            for actor in server.actors:
                if isinstance(actor, kind):
                    actor.on_tick(server.settings.fixed_delta_seconds)
        return server.ticks


class Blueprint:
    def __init__(self, name: str) -> None:
        self.id, self.attributes = name, {}

    def set_attribute(self, key: str, value: str) -> None:
        self.attributes[key] = value


class TrafficManager:
    def __init__(self, server: FakeServer, port: int) -> None:
        self._server, self._port = server, port

    def get_port(self) -> int:
        return self._port

    def set_synchronous_mode(self, on: bool) -> None:
        self._server.check()
        self._server.traffic_synchronous = on

    def set_random_device_seed(self, seed: int) -> None:
        self._server.seeds.append(("traffic", seed))

    def ignore_lights_percentage(self, car: Car, percentage: float) -> None:
        assert percentage == 100.0

    def set_path(self, car: Car, path: list[Any]) -> None:
        car.path = np.array([[place.x, place.y] for place in path])


class Actor:
    def __init__(self, server: FakeServer) -> None:
        self.server = server
        server.actors.append(self)

    def destroy(self) -> bool:
        self.server.check()
        self.server.actors.remove(self)
        return True


class Car(Actor):
    """A kinematic bicycle."""

    def __init__(self, server: FakeServer, at: Any) -> None:
        super().__init__(server)
        self.x, self.y, self.yaw = at.location.x, at.location.y, math.radians(at.rotation.yaw)
        self.speed = 0.0
        self.control = carla.VehicleControl()
        self.path: np.ndarray | None = None
        self.autopilot = False

    def apply_control(self, control: Any) -> None:
        self.server.check()
        assert isinstance(control, carla.VehicleControl)
        self.control = control

    def set_autopilot(self, on: bool, port: int) -> None:
        assert port == 8000
        self.autopilot = on

    def get_velocity(self) -> Any:
        return carla.Vector3D(self.speed * math.cos(self.yaw), self.speed * math.sin(self.yaw), 0)

    def get_location(self) -> Any:
        return carla.Location(self.x, self.y, 0.0)

    def on_tick(self, seconds: float) -> None:
        if self.autopilot and self.path is not None:
            self.control = self._pursuit(self.path)
        push = self.control.throttle * ACCELERATION_M_S2 - self.control.brake * BRAKING_M_S2
        self.speed = min(max(self.speed + push * seconds, 0.0), SPEED_M_S)
        self.yaw += (
            self.speed / WHEELBASE_M * math.tan(self.control.steer * MAX_STEER_RAD) * seconds
        )
        self.x += self.speed * math.cos(self.yaw) * seconds
        self.y += self.speed * math.sin(self.yaw) * seconds

    def _pursuit(self, path: np.ndarray) -> Any:
        gaps = np.hypot(*(path - (self.x, self.y)).T)
        x, y = path[min(int(gaps.argmin()) + 3, len(path) - 1)]
        angle = math.atan2(y - self.y, x - self.x) - self.yaw
        angle = math.remainder(angle, math.tau)
        throttle = 1.0 if self.speed < 6.0 else 0.0
        return carla.VehicleControl(throttle=throttle, steer=max(-1.0, min(1.0, 1.5 * angle)))


class Camera(Actor):
    """Draws the middles of the lanes ahead, dimmed by the weather."""

    def __init__(self, server: FakeServer, attributes: dict[str, str], at: Any, car: Car) -> None:
        super().__init__(server)
        self.rows = int(attributes["image_size_y"])
        self.columns = int(attributes["image_size_x"])
        self.focal = self.columns / 2 / math.tan(math.radians(float(attributes["fov"])) / 2)
        self.at, self.car, self.callback = at, car, None

    def listen(self, callback: Any) -> None:
        self.callback = callback

    def stop(self) -> None:
        self.callback = None

    def on_tick(self, seconds: float) -> None:
        ticks, every = self.server.ticks, self.server.drops_every
        if self.callback is not None and not (every and ticks % every == 0):
            picture = self.draw()
            self.callback(
                SimpleNamespace(
                    frame=ticks,
                    height=self.rows,
                    width=self.columns,
                    raw_data=picture.tobytes(),
                )
            )

    def draw(self) -> np.ndarray:
        """Return the picture, (rows, columns, 4), blue first as CARLA's."""
        light = brightness(self.server.weather)
        picture = np.full((self.rows, self.columns, 4), round(60 * light), np.uint8)
        points, yaws = lane_points()
        cos, sin = math.cos(self.car.yaw), math.sin(self.car.yaw)
        gap_x, gap_y = points[:, 0] - self.car.x, points[:, 1] - self.car.y
        ahead = gap_x * cos + gap_y * sin - self.at.location.x
        right = gap_y * cos - gap_x * sin
        seen = (ahead > 1.0) & (ahead < 30.0) & (np.abs(right) < 20.0)
        seen &= np.cos(yaws - self.car.yaw) > -0.2
        pitch, height = math.radians(self.at.rotation.pitch), self.at.location.z
        depth = ahead[seen] * math.cos(pitch) - height * math.sin(pitch)
        down = height * math.cos(pitch) + ahead[seen] * math.sin(pitch)
        rows = np.round(self.rows / 2 + self.focal * down / depth).astype(int)
        columns = np.round(self.columns / 2 + self.focal * right[seen] / depth).astype(int)
        bright = round(250 * light)
        for shift in (-1, 0, 1):
            inside = (rows >= 0) & (rows < self.rows)
            inside &= (columns + shift >= 0) & (columns + shift < self.columns)
            picture[rows[inside], columns[inside] + shift] = bright
        return picture


def brightness(weather: Any) -> float:
    """Return how bright the world is, from 0 to 1."""
    sun = min(1.0, max(0.0, weather.sun_altitude_angle / 45.0))
    grey = 0.4 * weather.precipitation / 100 + 0.2 * weather.wetness / 100
    return sun**0.5 * (1.0 - grey) * (1.0 - 0.8 * weather.fog_density / 100)


def lane_driver(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Steer to the lane's middle in some rows of the picture, as the command says."""
    rows = observation["image"][30:42, :, 0]
    columns = np.flatnonzero((rows > 140).any(axis=0))
    command = int(observation["command"].argmax())
    # beside the lane there may be another one of the same direction, far away
    columns = columns[np.abs(columns - 100) < (100 if command in (1, 2) else 30)]
    target = 100.0
    if len(columns):
        target = [np.median, np.min, np.max, np.median][command](columns)
    angle = math.atan2(target - 100.0, 84.0)
    return np.array([np.clip(2.0 * angle, -1, 1), 0.5 if observation["speed"][0] < 5.0 else 0.0])


def _copied(source: Any, target: Any) -> Any:
    for key in dir(source):
        if key.islower() and not key.startswith("_"):
            setattr(target, key, getattr(source, key))
    return target


@cache
def town() -> Any:
    """Return the town, a road with three junctions, as CARLA reads it."""
    return carla.Map("Town01", opendrive())


@cache
def lane_points() -> tuple[np.ndarray, np.ndarray]:
    """Return points in the middles of all lanes, (n, 2) in m, and their yaws, (n,) in rad."""
    places = [at.transform for at in town().generate_waypoints(0.5)]
    points = np.array([[at.location.x, at.location.y] for at in places])
    return points, np.radians([at.rotation.yaw for at in places])


def opendrive() -> str:
    """Write the town in OpenDRIVE: roads of two lanes, and all twelve ways through a junction."""
    root = Xml.Element("OpenDRIVE")
    Xml.SubElement(root, "header", revMajor="1", revMinor="4", name="fake", version="1")
    arms: dict[int, list[tuple[int, str, float]]] = {i: [] for i in range(len(JUNCTIONS_M))}
    number = 1
    last = len(JUNCTIONS_M)
    for i in range(last + 1):  # from west to east
        ends = [(i - 1, "start", 0.0)] * (i > 0) + [(i, "end", math.pi)] * (i < last)
        x = JUNCTIONS_M[0] - MOUTH_M - ROAD_M + i * (ROAD_M + 2 * MOUTH_M)
        _add_road(root, number, x, 0.0, 0.0, ends)
        for junction, contact, outward in ends:
            arms[junction].append((number, contact, outward))
        number += 1
    for i, x in enumerate(JUNCTIONS_M):
        for outward in (math.pi / 2, -math.pi / 2):
            y = MOUTH_M * math.sin(outward)
            _add_road(root, number, x, y, outward, [(i, "start", outward)])
            arms[i].append((number, "start", outward))
            number += 1
    for i, x in enumerate(JUNCTIONS_M):
        junction = Xml.Element("junction", id=str(100 + i), name=f"j{i}")
        ways = [(a, b) for a in arms[i] for b in arms[i] if a is not b]
        for k, (incoming, outgoing) in enumerate(ways):
            _add_way(root, junction, number, k, (100 + i, x), incoming, outgoing)
            number += 1
        root.append(junction)
    # junctions come behind all roads
    for junction in root.findall("junction"):
        root.remove(junction)
        root.append(junction)
    return '<?xml version="1.0"?>' + Xml.tostring(root, encoding="unicode")


def _road(root: Any, number: int, length: float, junction: int) -> tuple[Any, Any]:
    road = Xml.SubElement(
        root, "road", name=f"r{number}", length=f"{length:.9f}", id=str(number),
        junction=str(junction),
    )  # fmt: skip
    return road, Xml.SubElement(road, "link")


def _finish_road(
    road: Any, x: float, y: float, heading: float, length: float, curvature: float,
    lanes: dict[int, tuple[int, int] | None],
) -> None:  # fmt: skip
    view = Xml.SubElement(road, "planView")
    geometry = Xml.SubElement(
        view, "geometry", s="0", x=f"{x:.9f}", y=f"{y:.9f}", hdg=f"{heading:.9f}",
        length=f"{length:.9f}",
    )  # fmt: skip
    if curvature:
        Xml.SubElement(geometry, "arc", curvature=f"{curvature:.9f}")
    else:
        Xml.SubElement(geometry, "line")
    section = Xml.SubElement(Xml.SubElement(road, "lanes"), "laneSection", s="0")
    for side, ids in (("left", (1,)), ("center", (0,)), ("right", (-1,))):
        chosen = [i for i in ids if i == 0 or i in lanes]
        if not chosen:
            continue
        group = Xml.SubElement(section, side)
        for i in chosen:
            kind = "none" if i == 0 else "driving"
            lane = Xml.SubElement(group, "lane", id=str(i), type=kind, level="false")
            link = Xml.SubElement(lane, "link")
            if linked := lanes.get(i):
                Xml.SubElement(link, "predecessor", id=str(linked[0]))
                Xml.SubElement(link, "successor", id=str(linked[1]))
            if i:
                Xml.SubElement(lane, "width", sOffset="0", a=str(LANE_M), b="0", c="0", d="0")


def _add_road(
    root: Any, number: int, x: float, y: float, heading: float, ends: list[tuple[int, str, float]]
) -> None:
    road, link = _road(root, number, ROAD_M, -1)
    for junction, contact, _ in ends:
        which = "predecessor" if contact == "start" else "successor"
        Xml.SubElement(link, which, elementType="junction", elementId=str(100 + junction))
    _finish_road(road, x, y, heading, ROAD_M, 0.0, {1: None, -1: None})


def _add_way(
    root: Any, junction: Any, number: int, k: int, place: tuple[int, float],
    incoming: tuple[int, str, float], outgoing: tuple[int, str, float],
) -> None:  # fmt: skip
    junction_id, centre_m = place
    (road_in, contact_in, outward_in), (road_out, contact_out, outward_out) = incoming, outgoing
    heading = outward_in + math.pi
    turned = math.remainder(outward_out - heading, math.tau)
    straight = abs(turned) < 0.1
    length = 2 * MOUTH_M if straight else MOUTH_M * math.pi / 2
    road, link = _road(root, number, length, junction_id)
    Xml.SubElement(
        link, "predecessor", elementType="road", elementId=str(road_in), contactPoint=contact_in
    )
    Xml.SubElement(
        link, "successor", elementType="road", elementId=str(road_out), contactPoint=contact_out
    )
    lane_in = -1 if contact_in == "end" else 1
    lane_out = -1 if contact_out == "start" else 1
    x, y = centre_m + MOUTH_M * math.cos(outward_in), MOUTH_M * math.sin(outward_in)
    curvature = 0.0 if straight else math.copysign(1 / MOUTH_M, turned)
    _finish_road(road, x, y, heading, length, curvature, {-1: (lane_in, lane_out)})
    connection = Xml.SubElement(
        junction, "connection", id=str(k), incomingRoad=str(road_in), connectingRoad=str(number),
        contactPoint="start",
    )  # fmt: skip
    Xml.SubElement(connection, "laneLink", attrib={"from": str(lane_in), "to": "-1"})


if "FAKE_CARLA" in os.environ:  # a process of an attack, its workers too
    start_as_told(json.loads(os.environ["FAKE_CARLA"]))
