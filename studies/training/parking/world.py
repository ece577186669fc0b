"""The worlds of INDAGO's parking (Biagiola and Tonella 2023), on highway-env's `parking-v0`.

Twenty slots lie in two rows of ten. The car starts between the rows, standing, and is to stop in
one of the slots. In each of the others a car may be parked. The agent observes its own position,
speed and heading and those that it is to reach; it does not see the parked cars. It fails if it
hits one, or is not in its slot after 100 steps of 0.2 s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import KinematicsGoalObservation
from highway_env.envs.parking_env import ParkingEnv
from highway_env.road.lane import LineType, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Landmark, Obstacle

COLUMNS = 10
SLOTS = 2 * COLUMNS
STEPS = 100
HALF_X_M, HALF_Y_M = 10.0, 5.0
"""The car starts within so many metres of the middle."""
OTHERS = (
    *(f"next_{k}" for k in range(1, COLUMNS)),
    *(f"across_{k}" for k in range(COLUMNS)),
)
"""The slots beside the goal, counted from it: `next_1` is the next one in its row, `next_9` the one
before it, and `across_0` lies opposite. Behind the end of a row its beginning follows."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class World:
    """Where the car starts, where it is to go, and which slots are taken.

    Attributes:
        goal: The slot to reach, 0 to 19: the first ten lie in the row at y = 14 m, in the order of
            x, the others opposite.
        heading: The heading at the start, in turns, 0 to 1.
        x_m: The position at the start along the rows, -10 to 10.
        y_m: The position at the start between them, -5 to 5.
        parked: The slots that are taken, the goal not among them.
    """

    goal: int
    heading: float
    x_m: float
    y_m: float
    parked: frozenset[int]

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> World:
        """Draw each part uniformly; each slot but the goal is taken in every second world."""
        goal = int(generator.integers(SLOTS))
        heading, x, y = generator.uniform([0.0, -HALF_X_M, -HALF_Y_M], [1.0, HALF_X_M, HALF_Y_M])
        taken = np.flatnonzero(generator.random(SLOTS) < 0.5)
        return cls(goal, float(heading), float(x), float(y), frozenset(taken.tolist()) - {goal})

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> World:
        """Return the world that the options of a reset name.

        Args:
            options: `goal`, `heading`, `x`, `y`, and for each of `OTHERS` `free` or `parked`.
        """
        goal = int(options["goal"])
        parked = {
            slot
            for name, slot in zip(OTHERS, slots_from(goal), strict=True)
            if options[name] == "parked"
        }
        heading, x, y = (float(options[name]) for name in ("heading", "x", "y"))
        return cls(goal, heading, x, y, frozenset(parked))

    @property
    def options(self) -> dict[str, Any]:
        """The options of a reset that name the world."""
        taken = {
            name: "parked" if slot in self.parked else "free"
            for name, slot in zip(OTHERS, slots_from(self.goal), strict=True)
        }
        return {"goal": self.goal, "heading": self.heading, "x": self.x_m, "y": self.y_m} | taken

    @classmethod
    def from_features(cls, features: Sequence[float] | Floats) -> World:
        """Return the world of INDAGO's features, (24,)."""
        *taken, goal, heading, x, y = (float(value) for value in features)
        parked = frozenset(slot for slot, value in enumerate(taken) if value > 0.5)
        return cls(int(goal), heading, x, y, parked - {int(goal)})

    @property
    def features(self) -> Floats:
        """INDAGO's features, (24,): a 1 for each slot that is taken, goal, heading, x and y."""
        taken = [float(slot in self.parked) for slot in range(SLOTS)]
        return np.array([*taken, self.goal, self.heading, self.x_m, self.y_m])


def slots_from(goal: int) -> list[int]:
    """Return the 19 slots beside the goal in the order of `OTHERS`."""
    row, column = divmod(goal, COLUMNS)
    own = [row * COLUMNS + (column + k) % COLUMNS for k in range(1, COLUMNS)]
    return own + [(1 - row) * COLUMNS + (column + k) % COLUMNS for k in range(COLUMNS)]


class _Observation(KinematicsGoalObservation):  # type: ignore[misc]
    """The same numbers without pandas, which takes nine tenths of a step's time."""

    def observe(self) -> dict[str, Floats]:
        car = self.observer_vehicle
        if not car:
            nothing = np.zeros(len(self.features))
            return dict.fromkeys(("observation", "achieved_goal", "desired_goal"), nothing)
        own, goal = (
            np.array([values[feature] for feature in self.features]) / self.scales
            for values in (car.to_dict(), car.goal.to_dict())
        )
        return {"observation": own, "achieved_goal": own.copy(), "desired_goal": goal}


class _Car(Vehicle):  # type: ignore[misc]
    """A car that does not look for its lane, which nothing here asks for."""

    def on_state_update(self) -> None:
        """Keep the lane."""


class _ParkedCar(Obstacle):  # type: ignore[misc]
    LENGTH, WIDTH = Vehicle.LENGTH, Vehicle.WIDTH


class ParkingWorld(ParkingEnv):  # type: ignore[misc]
    """`parking-v0` with 20 slots, no walls, 100 steps, and a world that `reset` may name.

    `reset(options=world.options)` puts a world in place; without options each reset draws one. As
    in INDAGO, a crash costs 5 in the reward of every goal, relabelled ones too, and a car that has
    crashed has not succeeded.
    """

    def __init__(self, render_mode: str | None = None) -> None:
        self.world: World | None = None
        self._named: World | None = None
        super().__init__({"add_walls": False, "duration": STEPS}, render_mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, Any]]:
        """Start in the world that the options name, or in one that is drawn."""
        self._named = World.from_options(options) if options else None
        observation, info = super().reset(seed=seed)
        return observation, info

    def define_spaces(self) -> None:
        """Observe without pandas."""
        self.action_type = action_factory(self, self.config["action"])
        self.action_space = self.action_type.space()
        settings = {k: v for k, v in self.PARKING_OBS["observation"].items() if k != "type"}
        self.observation_type = self.observation_type_parking = _Observation(self, **settings)
        self.observation_space = self.observation_type.space()

    def _create_road(self, spots: int = COLUMNS) -> None:
        net = RoadNetwork()
        lines = (LineType.CONTINUOUS, LineType.CONTINUOUS)
        for nodes, side in ((("a", "b"), 1), (("b", "c"), -1)):
            for column in range(spots):
                x = 4.0 * (column - spots // 2) - 2.0
                ends = ([x, side * 10.0], [x, side * 18.0])
                net.add_lane(*nodes, StraightLane(*ends, width=4.0, line_types=lines))
        self.road = Road(network=net, np_random=self.np_random, record_history=False)

    def _create_vehicles(self) -> None:
        self.world = world = self._named or World.drawn(self.np_random)
        lanes = self.road.network.lanes_list()
        car = _Car(self.road, [world.x_m, world.y_m], 2.0 * np.pi * world.heading, 0.0)
        car.color = VehicleGraphics.EGO_COLOR
        self.controlled_vehicles = [car]
        self.road.vehicles.append(car)
        for slot in sorted(world.parked):
            lane = lanes[slot]
            # without a road, whose nearest lane each would look for
            parked = _ParkedCar(None, lane.position(lane.length / 2, 0), lane.heading)
            self.road.objects.append(parked)
        lane = lanes[world.goal]
        car.goal = Landmark(None, lane.position(lane.length / 2, 0), heading=lane.heading)
        self.road.objects.append(car.goal)

    def compute_reward(
        self,
        achieved_goal: Floats,
        desired_goal: Floats,
        info: Mapping[str, Any] | Sequence[Mapping[str, Any]],
        p: float = 0.5,
    ) -> Any:
        """Return the rewards, (...), of goals, (..., 6), and the information of their steps."""
        near = super().compute_reward(achieved_goal, desired_goal, {}, p)
        if isinstance(info, Mapping):
            crashed: Any = float(info.get("crashed", False))
        else:
            crashed = np.array([float(one.get("crashed", False)) for one in info])
        return near + self.config["collision_reward"] * crashed

    def _is_success(self, achieved_goal: Floats, desired_goal: Floats) -> bool:
        reward = self.compute_reward(achieved_goal, desired_goal, {"crashed": self.vehicle.crashed})
        return bool(reward > -self.config["success_goal_reward"])

    def _is_truncated(self) -> bool:
        return bool(round(self.time * self.config["policy_frequency"]) >= STEPS)

    def _info(self, obs: dict[str, Floats], action: Any = None) -> dict[str, Any]:  # noqa: ARG002
        success = self._is_success(obs["achieved_goal"], obs["desired_goal"])
        return {"crashed": bool(self.vehicle.crashed), "is_success": success}
