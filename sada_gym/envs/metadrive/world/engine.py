"""MetaDrive's engine, of which a process can have one: it is kept, and each world is made again.

MetaDrive is reset by its own settings alone. Where these leave something of the worlds before (its
physics, recycled cars) or leave an order to chance (a set of objects), a manager and a lidar of
ours, which it takes as settings, do the same in a fixed way, so that a world is the same whatever
came before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from sada_gym.agents.packaged import missing_packages
from sada_gym.envs.metadrive.start import SCENES, DriveStart
from sada_gym.errors import MissingPart, UserError
from sada_gym.foundations.arrays import Floats, Floats32

OTHERS, RAYS, LIDAR_M = 4, 240, 50.0
"""The nearest cars that are observed, the lidar's rays, and how far they reach."""
_CROSSINGS, _OPEN_ROAD = ("XTO", (0.15, 0.15, 0.1)), ("CSrR", (0.3, 0.1, 0.1, 0.1))
"""Crossings, and other blocks, by MetaDrive's letters, with the probabilities that it gives them
(`PGBlockDistConfig.BLOCK_TYPE_DISTRIBUTION_V2`)."""
_LAST_BLOCK = "C"


def missing() -> str:
    """Say what has to be installed for MetaDrive; empty where all is there."""
    return missing_packages({"metadrive-simulator": "0.4.3"}, "Python below 3.12")


def check_installed() -> None:
    """Raise `MissingPart` where MetaDrive is not installed, or another version."""
    if sentence := missing():
        raise MissingPart(sentence)


class Engine:
    """The engine of this process.

    Attributes:
        env: The `MetaDriveEnv`.
        world: Counts the worlds that have begun: who holds an older one has lost it.
    """

    def __init__(self) -> None:
        check_installed()
        from metadrive import MetaDriveEnv
        from metadrive.engine.engine_utils import engine_initialized

        if engine_initialized():
            raise UserError(
                "Expected no other MetaDrive environment in this process, because MetaDrive allows "
                "one engine a process, got one that is open. Call its close() first."
            )
        self.world = 0
        self.env: Any = MetaDriveEnv(_settings())
        with _no_download():
            self.env.lazy_init()  # it has accidents; in a first world without any it would never

    def begin(self, start: DriveStart) -> tuple[int, Floats32]:
        """Begin the world of a start; return its number and the first observation."""
        from metadrive.component.pg_space import BlockParameterSpace, ConstantSpace, ParameterSpace
        from metadrive.component.pgblock.curve import Curve

        self.world += 1
        conditions, config = start.conditions, self.env.config
        rng = np.random.default_rng(start.seed)
        crossing = rng.random() < conditions["junctions"]
        letters, weights = _CROSSINGS if crossing else _OPEN_ROAD
        block = letters[int(np.searchsorted(np.cumsum(weights) / sum(weights), rng.random()))]
        config["traffic_density"] = conditions["traffic_density"]
        config["accident_prob"] = conditions["accident_prob"]
        config["map_config"].update(
            {
                "type": "block_sequence",
                "config": block + _LAST_BLOCK,
                "lane_width": conditions["lane_width_m"],
                "lane_num": round(conditions["lanes"]),
            }
        )
        space = Curve.PARAMETER_SPACE
        Curve.PARAMETER_SPACE = ParameterSpace(
            {**BlockParameterSpace.CURVE, "radius": ConstantSpace(conditions["curve_radius_m"])}
        )
        try:
            with _no_download():
                observation, _ = self.env.reset(seed=start.scene)
        except BaseException:  # a world that is half made would break the next
            close_engine()
            raise
        finally:
            Curve.PARAMETER_SPACE = space
        self._set_manners(start, rng)
        car = self.env.agent
        car.config["max_brake_force"] = conditions["brake_force"]
        car.body.setMass(conditions["mass_kg"])
        return self.world, observation

    def roads(self) -> tuple[tuple[Floats, bool], ...]:
        """Return the outline of each lane, (points, 2), and whether it leads to the goal."""
        car, network = self.env.agent, self.env.current_map.road_network
        route = [*zip(car.navigation.checkpoints[:-1], car.navigation.checkpoints[1:], strict=True)]
        found = []
        for begin, ends in network.graph.items():
            for end, lanes in ends.items():
                for lane in lanes:
                    along = np.linspace(0.0, lane.length, max(2, math.ceil(lane.length / 3) + 1))
                    half = lane.width / 2
                    left = [lane.position(x, -half) for x in along]
                    right = [lane.position(x, half) for x in along[::-1]]
                    found.append((np.array(left + right, np.float64), (begin, end) in route))
        return tuple(found)

    def around(self) -> tuple[list[list[float]], list[list[float]]]:
        """Return other cars, (x, y, heading, length, width), and objects on the road, (x, y)."""
        from metadrive.component.vehicle.base_vehicle import BaseVehicle

        cars, things = [], []
        for thing in self.env.engine.get_objects().values():
            x, y = thing.position
            if not isinstance(thing, BaseVehicle):
                things.append([float(x), float(y)])
            elif thing is not self.env.agent:
                cars.append([float(x), float(y), thing.heading_theta, thing.LENGTH, thing.WIDTH])
        return cars, things

    def _set_manners(self, start: DriveStart, rng: np.random.Generator) -> None:
        from metadrive.policy.idm_policy import IDMPolicy

        conditions = start.conditions
        for policy in self.env.engine.get_policies().values():
            if isinstance(policy, IDMPolicy):
                drawn = conditions["traffic_spread_km_h"] * float(rng.standard_normal())
                speed = max(10.0, conditions["traffic_speed_km_h"] + drawn)
                policy.NORMAL_SPEED = policy.target_speed = speed
                policy.TIME_WANTED = conditions["traffic_gap_s"]
                policy.SAFE_LANE_CHANGE_DISTANCE = conditions["cut_in_gap_m"]


@cache
def engine() -> Engine:
    """Return the engine of this process; it starts when it is first asked for."""
    return Engine()


def close_engine() -> None:
    """Close this process's engine, so that another MetaDrive environment can have one."""
    if engine.cache_info().currsize:
        engine().env.close()
        engine.cache_clear()


@contextmanager
def _no_download() -> Iterator[None]:
    """Let the engine start without its assets, which only pictures need.

    MetaDrive would download them into its own folder.
    """
    from metadrive.engine.base_engine import BaseEngine

    pull = BaseEngine.__dict__["try_pull_asset"]
    BaseEngine.try_pull_asset = staticmethod(lambda: None)
    try:
        yield
    finally:
        BaseEngine.try_pull_asset = pull


def _settings() -> dict[str, Any]:
    from metadrive.component.sensors.lidar import Lidar

    class OrderedLidar(Lidar):  # type: ignore[misc]
        """Lists what is near in the order of its distance: drivers go through this list."""

        def get_surrounding_objects(self, vehicle: Any, radius: int = 50) -> list[Any]:
            found = super().get_surrounding_objects(vehicle, radius)
            x, y = vehicle.position

            def place(thing: Any) -> tuple[float, float, float]:
                a, b = thing.position
                return math.hypot(a - x, b - y), float(a), float(b)

            return sorted(found, key=place)

    return {
        "use_render": False,
        "log_level": 50,
        "show_terrain": False,
        "num_scenarios": SCENES,
        "start_seed": 0,
        "store_map": False,
        "force_destroy": True,
        "accident_prob": 0.5,
        "sensors": {"lidar": (OrderedLidar,)},
        "vehicle_config": {
            "vehicle_model": "static_default",
            "lidar": {"num_lasers": RAYS, "distance": LIDAR_M, "num_others": OTHERS},
        },
    }
