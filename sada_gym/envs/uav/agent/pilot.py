"""Pilots: networks that see where the next gate is, and models that choose actions themselves.

Either gets what its drone sees, and gives what the flight controller is told, in lockstep, each as
if it were alone.
"""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
import torch

from sada_gym import agents
from sada_gym.agents.policy import Policy
from sada_gym.agents.wrappers import Acting
from sada_gym.compiled import kernel
from sada_gym.determinism import one_thread
from sada_gym.envs.uav.agent.network import WaypointNetwork, light
from sada_gym.envs.uav.camera.pinhole import Pictures, camera
from sada_gym.envs.uav.races import Races
from sada_gym.envs.uav.task import ACTION_SPACE, OBSERVATION_SPACE
from sada_gym.envs.uav.world.guidance import SPEED_M_S, steer
from sada_gym.errors import UserError

TILE = 8
"""The network always sees this many pictures at once, padded: a batch of another size would give
other last bits, and a closed loop makes another flight of them."""

UNIT_M_S, UNIT_RAD_S = 10.0, 5.0
"""Of the drone's own motion."""
REACH_M = 10.0
"""The unit of the network's waypoints."""

Floats = npt.NDArray[np.float64]


@runtime_checkable
class Pilot(Protocol):
    """What flies drones."""

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over what its actions depend on, None where it is unknown."""

    def start(self, count: int) -> None:
        """Forget what `count` drones saw."""

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones."""
        ...


PilotLike: TypeAlias = WaypointNetwork | Acting | Pilot
"""What can fly: a perception network, an SB3 model of the racing task, or a pilot as it is."""


class WaypointPilot:
    """Says where the next gate is, from what the drone's camera sees and what the drone feels.

    Args:
        network: The perception.
    """

    def __init__(self, network: WaypointNetwork) -> None:
        self.network = network.eval()
        self._camera = camera()

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the network's weights."""
        return agents.fingerprint(self.network)

    def start(self, count: int) -> None:
        """Nothing is remembered."""

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones."""
        looks = [races.starts[i].seed for i in which.tolist()]
        seen = self.waypoints(races.gates[which], races.states[which], looks)
        actions: Floats = steer(seen, SPEED_M_S)
        return actions

    def waypoints(self, gates: Floats, poses: Floats, looks: npt.ArrayLike) -> Floats:
        """Where n drones see their next gates.

        Args:
            gates: (n, g, 4) all gates of each course, for the camera.
            poses: (n, 13): position, quaternion x, y, z, w, velocity, angular velocity.
            looks: (n,) integers, for the camera.

        Returns:
            (n, 4): in each drone's level frame, as `guidance` has them.
        """
        pictures, felt = self._camera.draw(gates, poses, looks), motion(poses)
        parts = [
            self._see(pictures[start : start + TILE], felt[start : start + TILE])
            for start in range(0, len(poses), TILE)
        ]
        return in_level(poses, np.concatenate(parts)) if parts else np.empty((0, 4))

    def _see(self, pictures: Pictures, felt: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        rows = len(pictures)
        if rows < TILE:
            pictures = np.concatenate([pictures, np.repeat(pictures[:1], TILE - rows, axis=0)])
            felt = np.concatenate([felt, np.repeat(felt[:1], TILE - rows, axis=0)])
        with one_thread(), torch.inference_mode():
            answer = self.network(light(torch.from_numpy(pictures)), torch.from_numpy(felt))
        if answer.shape != (TILE, 6):
            raise UserError(
                f"Expected answers of shape {(TILE, 6)} from {type(self.network).__name__}, got "
                f"{tuple(answer.shape)}."
            )
        seen: npt.NDArray[np.float32] = answer.numpy()[:rows]
        return np.where(np.isfinite(seen), seen, np.float32(np.nan))


class TaskPilot:
    """Lets an SB3 model fly, deterministically and each drone as if it were alone.

    Args:
        model: Trained on `SADA-RacingTask-v0`.

    Raises:
        ValueError: If its spaces are not the task's.
    """

    def __init__(self, model: Acting) -> None:
        self._policy = Policy(model, OBSERVATION_SPACE, ACTION_SPACE, "SADA-RacingTask-v0")

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown."""
        return self._policy.fingerprint

    def start(self, count: int) -> None:
        """Forget what `count` drones saw."""
        self._policy.start(count)

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones; NaN where the model gives none.

        Raises:
            ValueError: If the model gives something of another shape.
        """
        return self._policy.act(races.observe(which), which)


def pilot(agent: PilotLike) -> Pilot:
    """What flies drones as an agent has it.

    Args:
        agent: A perception network, an SB3 model, or a pilot as it is.

    Raises:
        ValueError: If it is none of these, or a model's spaces are not the racing task's.
    """
    if isinstance(agent, WaypointNetwork):
        return WaypointPilot(agent)
    if isinstance(agent, Pilot):
        return agent
    if not hasattr(agent, "predict"):
        lacking = [name for name in ("fingerprint", "start", "act") if not hasattr(agent, name)]
        raise UserError(
            "Expected a WaypointNetwork, an SB3 model trained on SADA-RacingTask-v0, or an object "
            "with fingerprint, start(count) and act(races, which), got "
            f"{type(agent).__name__}, which has no {' and no '.join(lacking)}. Add what is missing."
        )
    return TaskPilot(agent)


def motion(poses: Floats) -> npt.NDArray[np.float32]:
    """What drones feel, (n, 9): up, velocity in 10 m/s and turning in 5 rad/s, in their own frame.

    Args:
        poses: (n, 13): position, quaternion x, y, z, w, velocity, angular velocity.
    """
    felt = np.empty((len(poses), 9), np.float32)
    _feel(poses, felt)
    return felt


def in_level(poses: Floats, answers: npt.NDArray[np.float32]) -> Floats:
    """Turn the network's answers (n, 6) into waypoints (n, 4) as `guidance` has them."""
    waypoints = np.empty((len(poses), 4))
    _to_level(poses, answers.astype(np.float64), waypoints)
    return waypoints


def in_drone(poses: Floats, waypoints: Floats) -> npt.NDArray[np.float32]:
    """Turn waypoints (n, 4) into what the network should answer, (n, 6)."""
    answers = np.empty((len(poses), 6), np.float32)
    _to_drone(poses, waypoints, answers)
    return answers


@kernel
def _axes(q: Floats, axes: Floats) -> None:
    """The drone's axes in the world, one a row, of a quaternion x, y, z, w."""
    x, y, z, w = q
    axes[0] = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    axes[1] = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    axes[2] = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)


@kernel
def _along(axes: Floats, k: int, x: float, y: float, z: float) -> float:
    along: float = axes[k, 0] * x + axes[k, 1] * y + axes[k, 2] * z
    return along


@kernel
def _feel(poses: Floats, felt: npt.NDArray[np.float32]) -> None:
    axes = np.empty((3, 3))
    for i in range(len(poses)):
        _axes(poses[i, 3:7], axes)
        speed, turn = poses[i, 7:10], poses[i, 10:13]
        for k in range(3):
            felt[i, k] = axes[k, 2]
            felt[i, 3 + k] = _along(axes, k, speed[0], speed[1], speed[2]) / UNIT_M_S
            felt[i, 6 + k] = _along(axes, k, turn[0], turn[1], turn[2]) / UNIT_RAD_S


@kernel
def _level(axes: Floats) -> None:
    """The axes of the level frame, x to the drone's heading, in place of the drone's own."""
    size = math.hypot(axes[0, 0], axes[0, 1])
    cos, sin = (axes[0, 0] / size, axes[0, 1] / size) if size > 0 else (1.0, 0.0)
    axes[0], axes[1], axes[2] = (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)


@kernel
def _to_level(poses: Floats, answers: Floats, waypoints: Floats) -> None:
    own, level = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(poses)):
        _axes(poses[i, 3:7], own)
        level[:] = own
        _level(level)
        x, y = 0.0, 0.0
        waypoints[i] = 0.0
        for k in range(3):
            for m in range(3):
                part = _along(level, m, own[k, 0], own[k, 1], own[k, 2])
                waypoints[i, m] += REACH_M * part * answers[i, k]
                x += part * answers[i, 3 + k] if m == 0 else 0.0
                y += part * answers[i, 3 + k] if m == 1 else 0.0
        waypoints[i, 3] = math.atan2(y, x)


@kernel
def _to_drone(poses: Floats, waypoints: Floats, answers: npt.NDArray[np.float32]) -> None:
    own, level = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(poses)):
        _axes(poses[i, 3:7], own)
        level[:] = own
        _level(level)
        cos, sin = math.cos(waypoints[i, 3]), math.sin(waypoints[i, 3])
        for k in range(3):
            x = _along(own, k, level[0, 0], level[0, 1], level[0, 2])
            y = _along(own, k, level[1, 0], level[1, 1], level[1, 2])
            up = own[k, 2]
            off = x * waypoints[i, 0] + y * waypoints[i, 1] + up * waypoints[i, 2]
            answers[i, k] = off / REACH_M
            answers[i, 3 + k] = x * cos + y * sin
