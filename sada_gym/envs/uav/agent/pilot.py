"""Pilots: networks that see where the next gate is, and models that choose actions themselves.

Either chooses the actions of drones in lockstep, each as if it were alone.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
import torch

from sada_gym import agents
from sada_gym.agents.policy import Policy
from sada_gym.agents.wrappers import Predictor
from sada_gym.determinism import one_thread
from sada_gym.envs.uav.agent.drone_frame import Floats, in_level, motion
from sada_gym.envs.uav.agent.network import WaypointNetwork, light
from sada_gym.envs.uav.camera.pinhole import Pictures, camera
from sada_gym.envs.uav.episodes import Races
from sada_gym.envs.uav.task import ACTION_SPACE, OBSERVATION_SPACE
from sada_gym.envs.uav.world.guidance import SPEED_M_S, steer
from sada_gym.errors import UserError

TILE = 8
"""The network always sees this many pictures at once, padded: a batch of another size would give
other last bits, and a closed loop makes another flight of them."""


@runtime_checkable
class Pilot(Protocol):
    """Chooses the actions of drones."""

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over what its actions depend on, None where it is unknown."""

    def start(self, count: int) -> None:
        """Begin new races of `count` drones."""

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones."""
        ...


PilotLike: TypeAlias = WaypointNetwork | Predictor | Pilot
"""What can fly: a perception network, an SB3 model of the racing task, or a pilot as it is."""


class WaypointPilot:
    """Says where the next gate is, from the camera's image and the drone's motion.

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

    @property
    def use(self) -> dict[str, Any]:
        """How the network is used, as far as an action depends on it: for `agents.identity`."""
        return {"tile": TILE, "speed_m_s": SPEED_M_S}

    def start(self, count: int) -> None:
        """Nothing is remembered."""

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones."""
        seeds = [races.starts[i].seed for i in which.tolist()]
        waypoints = self.waypoints(races.gates[which], races.states[which], seeds)
        actions: Floats = steer(waypoints, SPEED_M_S)
        return actions

    def waypoints(self, gates: Floats, poses: Floats, seeds: npt.ArrayLike) -> Floats:
        """Where n drones see their next gates.

        Args:
            gates: (n, g, 4) all gates of each course, for the camera.
            poses: (n, 13): position, quaternion x, y, z, w, velocity, angular velocity.
            seeds: (n,) integers that fix light and background, for the camera.

        Returns:
            (n, 4): in each drone's level frame, as `guidance` has them.
        """
        images, motions = self._camera.draw(gates, poses, seeds), motion(poses)
        parts = [
            self._answer(images[start : start + TILE], motions[start : start + TILE])
            for start in range(0, len(poses), TILE)
        ]
        return in_level(poses, np.concatenate(parts)) if parts else np.empty((0, 4))

    def _answer(
        self, images: Pictures, motions: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """The network's answers (n, 6) to at most `TILE` images, NaN where not finite."""
        rows = len(images)
        if rows < TILE:
            images = np.concatenate([images, np.repeat(images[:1], TILE - rows, axis=0)])
            motions = np.concatenate([motions, np.repeat(motions[:1], TILE - rows, axis=0)])
        with one_thread(), torch.inference_mode():
            answers = self.network(light(torch.from_numpy(images)), torch.from_numpy(motions))
        if answers.shape != (TILE, 6):
            raise UserError(
                f"Expected answers of shape {(TILE, 6)} from {type(self.network).__name__}, got "
                f"{tuple(answers.shape)}."
            )
        known: npt.NDArray[np.float32] = answers.numpy()[:rows]
        return np.where(np.isfinite(known), known, np.float32(np.nan))


class TaskPilot:
    """Lets an SB3 model fly, deterministically and each drone as if it were alone.

    Args:
        model: Trained on `SADA-RacingTask-v0`.

    Raises:
        UserError: If its spaces are not the task's.
    """

    def __init__(self, model: Predictor) -> None:
        self._policy = Policy(model, OBSERVATION_SPACE, ACTION_SPACE, "SADA-RacingTask-v0")

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown."""
        return self._policy.fingerprint

    @property
    def use(self) -> dict[str, Any]:
        """How the model is used, as far as an action depends on it: for `agents.identity`."""
        return self._policy.use

    def start(self, count: int) -> None:
        """Begin new races of `count` drones."""
        self._policy.start(count)

    def act(self, races: Races, which: npt.NDArray[np.intp]) -> Floats:
        """Choose actions (n, 4) for some of the drones; NaN where the model gives none.

        Raises:
            UserError: If the model gives actions of another shape.
        """
        return self._policy.act(races.observe(which), which)


def as_pilot(agent: PilotLike) -> Pilot:
    """The pilot that an agent means.

    Args:
        agent: A perception network, an SB3 model, or a pilot as it is.

    Raises:
        UserError: If it is none of these, or a model's spaces are not the racing task's.
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
