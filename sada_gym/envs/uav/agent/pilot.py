"""Pilots: networks that see where the next gate is, and models that choose actions themselves.

Either chooses the actions of drones in lockstep, each as if it were alone.
"""

from __future__ import annotations

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
from sada_gym.envs.uav.agent.drone_frame import in_level, motion
from sada_gym.envs.uav.agent.network import WaypointNetwork, light
from sada_gym.envs.uav.camera.pinhole import camera
from sada_gym.envs.uav.episodes import RacingEpisodes
from sada_gym.envs.uav.world.guidance import SPEED_M_S, steer
from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Floats, Floats32, Indices

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
