"""Pilots: networks that see where the next gate is, and models that choose actions themselves.

Either chooses the actions of drones in lockstep, each as if it were alone. The privileged pilot
knows where the next gate is and flies there by the guidance. It shows that a track can be flown,
slowly if need be, and faster it is the expert that the perception network imitates.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import torch

from sada_gym.agents.contract import Agent, as_agent
from sada_gym.agents.identity import fingerprint
from sada_gym.agents.policy import Policy
from sada_gym.agents.tile import Batch, tiled
from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.uav.agent.network import WaypointNetwork, light
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.episodes import RacingEpisodes
from sada_gym.envs.uav.world.drone import rotation
from sada_gym.envs.uav.world.guidance import SPEED_M_S, steer
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats, Floats32, Indices
from sada_gym.foundations.compiled import kernel

UNIT_M_S, UNIT_RAD_S = 10.0, 5.0
"""The speed and the turning rate that the network is given as 1."""
REACH_M = 10.0
"""The unit of the network's waypoints."""


def motion(poses: Floats) -> Floats32:
    """Return motion (n, 9) in drones' own frame: up, velocity in 10 m/s, turning in 5 rad/s.

    Poses (n, 13) are position, quaternion x, y, z, w, velocity and angular velocity.
    """
    motions = np.empty((len(poses), 9), np.float32)
    _to_motion(poses, motions)
    return motions


def in_level(poses: Floats, answers: Floats32) -> Floats:
    """Turn the network's answers (n, 6) into waypoints (n, 4) as `guidance` has them."""
    waypoints = np.empty((len(poses), 4))
    _to_level(poses, answers.astype(np.float64), waypoints)
    return waypoints


@kernel
def axes_of(q: Floats) -> Floats:
    """Return the drone's axes in the world, one a row, of a quaternion x, y, z, w."""
    return rotation(q[0], q[1], q[2], q[3]).T


@kernel
def along(axes: Floats, k: int, x: float, y: float, z: float) -> float:
    """Return the part of a vector along one of the axes."""
    part: float = axes[k, 0] * x + axes[k, 1] * y + axes[k, 2] * z
    return part


@kernel
def _to_motion(poses: Floats, motions: Floats32) -> None:
    for i in range(len(poses)):
        axes = axes_of(poses[i, 3:7])
        speed, turn = poses[i, 7:10], poses[i, 10:13]
        for k in range(3):
            motions[i, k] = axes[k, 2]
            motions[i, 3 + k] = along(axes, k, speed[0], speed[1], speed[2]) / UNIT_M_S
            motions[i, 6 + k] = along(axes, k, turn[0], turn[1], turn[2]) / UNIT_RAD_S


@kernel
def level_axes(axes: Floats) -> None:
    """Replace the drone's axes by those of the level frame, x to the drone's heading."""
    size = math.hypot(axes[0, 0], axes[0, 1])
    cos, sin = (axes[0, 0] / size, axes[0, 1] / size) if size > 0 else (1.0, 0.0)
    axes[0], axes[1], axes[2] = (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)


@kernel
def _to_level(poses: Floats, answers: Floats, waypoints: Floats) -> None:
    level = np.empty((3, 3))
    for i in range(len(poses)):
        own = axes_of(poses[i, 3:7])
        level[:] = own
        level_axes(level)
        x, y = 0.0, 0.0
        waypoints[i] = 0.0
        for k in range(3):
            for m in range(3):
                part = along(level, m, own[k, 0], own[k, 1], own[k, 2])
                waypoints[i, m] += REACH_M * part * answers[i, k]
                x += part * answers[i, 3 + k] if m == 0 else 0.0
                y += part * answers[i, 3 + k] if m == 1 else 0.0
        waypoints[i, 3] = math.atan2(y, x)


WAYPOINT_TILE = 8
"""The images in one call of the perception network."""


Pilot: TypeAlias = Agent[RacingEpisodes, Floats]
"""Chooses the actions of drones."""

PilotLike: TypeAlias = WaypointNetwork | Predictor | Pilot
"""What can fly: a perception network, an SB3 model of the racing task, or an agent as it is."""


class WaypointPilot:
    """Says where the next gate is, from the camera's image and the drone's motion."""

    def __init__(self, network: WaypointNetwork) -> None:
        self.network = network.eval()
        self._camera = camera()

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the network's weights."""
        return fingerprint(self.network)

    @property
    def settings(self) -> dict[str, Any]:
        """How the network is used, as far as an action depends on it."""
        return {"tile": WAYPOINT_TILE, "speed_m_s": SPEED_M_S}

    def start(self, count: int) -> None:
        """Begin new races; nothing is remembered."""

    def act(self, races: RacingEpisodes, which: Indices) -> Floats:
        """Choose actions (n, 4) for some drones."""
        seeds = [races.starts[i].seed for i in which.tolist()]
        waypoints = self.waypoints(races.gates[which], races.states[which], seeds)
        actions: Floats = steer(waypoints, SPEED_M_S)
        return actions

    def waypoints(self, gates: Floats, poses: Floats, seeds: npt.ArrayLike) -> Floats:
        """Say where n drones see their next gates.

        `gates` (n, g, 4) all gates of each track, for the camera; `poses` (n, 13): position,
        quaternion x, y, z, w, velocity, angular velocity; `seeds` (n,) integers that fix light and
        background, for the camera. Returns (n, 4): in each drone's level frame, as `guidance` has
        them.
        """
        batch: Batch = {"image": self._camera.draw(gates, poses, seeds), "motion": motion(poses)}
        answers = tiled(self._answer, batch, WAYPOINT_TILE)
        return in_level(poses, np.concatenate(answers)) if answers else np.empty((0, 4))

    def _answer(self, batch: Batch) -> Floats32:
        """Return the network's answers (WAYPOINT_TILE, 6) to a tile, NaN where not finite."""
        with torch.inference_mode():
            images, motions = (torch.from_numpy(batch[key]) for key in ("image", "motion"))
            answers = self.network(light(images), motions)
        shape = (WAYPOINT_TILE, 6)
        if answers.shape != shape:
            raise UserError(
                f"Expected answers of shape {shape} from {type(self.network).__name__}, got "
                f"{tuple(answers.shape)}."
            )
        numbers: Floats32 = answers.numpy()
        return np.where(np.isfinite(numbers), numbers, np.float32(np.nan))


def as_pilot(agent: Any) -> Pilot:
    """Return the pilot that an agent means; raise `UserError` unless it is a `PilotLike`."""
    if isinstance(agent, WaypointNetwork):
        return WaypointPilot(agent)
    kinds = f"a WaypointNetwork, an SB3 model trained on {RacingEpisodes.task_id}"
    return as_agent(agent, partial(Policy, episodes=RacingEpisodes), kinds)


FEASIBLE_SPEED_M_S = 7.0
"""The speed at which it says whether a track can be flown, chosen by `studies/racing_speeds.py`."""


class PrivilegedPilot:
    """Flies drones through gates whose true poses it knows, at the speed of the guidance."""

    def __init__(self, speed_m_s: float = FEASIBLE_SPEED_M_S) -> None:
        self._speed_m_s = speed_m_s
        # the name under which stores know it, from when it was called the reference
        self.fingerprint = f"reference at {speed_m_s:g} m/s"

    def start(self, count: int) -> None:
        """Begin new races; nothing is remembered."""

    def act(self, races: RacingEpisodes, which: Indices) -> Floats:
        """Choose actions (n, 4) for some drones."""
        actions: Floats = steer(races.waypoints(which), self._speed_m_s)
        return actions
