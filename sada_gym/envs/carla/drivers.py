"""Drivers in CARLA: networks of conditional imitation learning, and the autopilot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym import agents
from sada_gym.agents.agent_files import find_agent_file, load_agent_file
from sada_gym.agents.contract import Agent, Indices, Interface
from sada_gym.agents.functions import agent_of
from sada_gym.envs.carla.drive import ACTION_SPACE, OBSERVATION_SPACE, Drive
from sada_gym.errors import UserError, explained
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.determinism import one_thread

AUTOPILOT = "autopilot"
_FOLLOW_OF_CIL = 2
INTERFACE = Interface("a driving task in CARLA with these spaces", OBSERVATION_SPACE, ACTION_SPACE)


class Autopilot:
    """CARLA's traffic manager drives; it knows the whole world and looks through no camera."""

    fingerprint = AUTOPILOT

    def start(self, count: int) -> None:
        """Begin new episodes."""

    def act(self, episodes: Drive, which: Indices) -> Floats:
        """Hand the car to the traffic manager; the actions say nothing."""
        episodes.hand_over()
        return np.zeros((len(which), 2))


class CilDriver:
    """A torch module in the convention of conditional imitation learning (Codevilla, 2018).

    It is called with the image, (1, 3, 88, 200) in [0, 1], the speed, (1, 1) in m/s, and the
    command, (1,) int64: 2 follow, 3 left, 4 right, 5 straight. It returns (1, 3), or three
    tensors: steer in [-1, 1], throttle and brake in [0, 1].
    """

    def __init__(self, module: Any) -> None:
        self._module = module.eval()

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the module's class and weights."""
        return agents.fingerprint(self._module)

    def start(self, count: int) -> None:
        """Begin new episodes."""

    def act(self, episodes: Drive, which: Indices) -> Floats:
        """Return steer, throttle and brake, (len(which), 3).

        Raises:
            UserError: If the module raises, or returns something else.
        """
        return np.stack([self._act(episodes.observation(i)) for i in which.tolist()])

    def _act(self, seen: dict[str, npt.NDArray[Any]]) -> Floats:
        import torch

        image = torch.from_numpy(seen["image"].transpose(2, 0, 1)[None].astype(np.float32) / 255)
        speed = torch.from_numpy(seen["speed"][None])
        command = torch.tensor([int(seen["command"].argmax()) + _FOLLOW_OF_CIL])
        name = type(self._module).__name__
        expected = f"Expected steer, throttle and brake, (1, 3), of {name}(image, speed, command)"
        with one_thread(), torch.no_grad(), explained(expected):
            answer = self._module(image, speed, command)
            if isinstance(answer, tuple | list):
                answer = torch.cat([part.reshape(1, 1) for part in answer], dim=1)
            action = answer.detach().cpu().numpy().astype(np.float64)
        if action.shape != (1, 3):
            raise UserError(f"{expected}, got {action.shape}.")
        return np.asarray(action[0])


def as_driver(given: Any, agent_id: str | None) -> tuple[str, Any, Agent[Any, Any]]:
    """Return a driver's name, the object that was given or loaded, and what acts for it.

    Args:
        given: `autopilot`; a file of SB3, ONNX or TorchScript; a torch module, see `CilDriver`; or
            what `agent_of` takes.
        agent_id: The name that its owner gave it.

    Raises:
        UserError: If it is none of these, or does not fit the spaces.
    """
    if isinstance(given, str) and given == AUTOPILOT:
        return AUTOPILOT, None, Autopilot()
    name = agent_id or str(getattr(given, "__name__", type(given).__name__))
    if isinstance(given, str | Path):
        name = str(given)
        given = load_agent_file(
            find_agent_file(given),
            OBSERVATION_SPACE,
            ACTION_SPACE,
            allow_pickle=False,
            has_statistics=False,
        )
    agents.check_finite_weights(given)
    if _is_module(given):
        return name, given, CilDriver(given)
    return name, given, agent_of(given, INTERFACE, name)


def _is_module(given: Any) -> bool:
    import torch

    return isinstance(given, torch.nn.Module) and not hasattr(given, "predict")
