"""The frozen agents that are shipped: their names, files and SHA-256, and how to load them."""

from __future__ import annotations

import difflib
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sada_gym.errors import UserError
from sada_gym.generators import generators_kept

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.base_class import BaseAlgorithm

    from sada_gym.agents.detector.model import Detector
    from sada_gym.agents.pilot.network import WaypointNetwork


@dataclass(frozen=True)
class AgentCard:
    """A shipped agent.

    Attributes:
        name: What `agent=` takes.
        application: The applications that it serves.
        file: Its weights, relative to this package.
        sha256: Of that file; a file that differs is refused.
        summary: A line for people.
    """

    name: str
    application: str
    file: str
    sha256: str
    summary: str

    @property
    def path(self) -> Path:
        """Where the weights lie."""
        return Path(__file__).parent / self.file


AGENTS = (
    AgentCard(
        "photographer",
        "SADA-Detection",
        "detector/photographer.safetensors",
        "9a7ec7022a5388f2692c60a08b404d9f20f2cc67a08f4a652b61f2cf6648b016",
        "detector trained on the views that people photograph; the default",
    ),
    AgentCard(
        "surveyor",
        "SADA-Detection",
        "detector/surveyor.safetensors",
        "6c62a41b9911d7ba3f836d0a52c1a5f6ff2d3049dff255e66ce8c0b410624c3f",
        "the same with one training view in ten from everywhere",
    ),
    AgentCard(
        "cil",
        "SADA-Driving",
        "driver/cil.zip",
        "210c212fbdbe1bc38b7b269ed15049ce335872f03e77bfbe09c71b9c913226b6",
        "imitates an expert, at the default camera in four weathers; the default",
    ),
    AgentCard(
        "cil-augmented",
        "SADA-Driving",
        "driver/cil-augmented.zip",
        "73aa7706fb15cc1f4b0394f032cda9eb9a179bb29975e8cd7fd2be44f6b315e7",
        "the same, with another camera each drive and stronger changes of the light",
    ),
    AgentCard(
        "ppo",
        "SADA-Driving",
        "driver/ppo.zip",
        "14ea7ff9c211769788996e9ec07291fd20bf6433f57c640035dd1a9ccab01596",
        "cil, trained on by PPO on the driving task",
    ),
    AgentCard(
        "waypoint-pid",
        "SADA-UAV",
        "pilot/waypoint-pid.safetensors",
        "c26fa779414358f7d365e858cde0633fc1df652e4b02c98b33df3c214379c9e6",
        "sees where the next gate is and flies there; trained on mild tracks; the default",
    ),
    AgentCard(
        "ppo",
        "SADA-UAV",
        "pilot/ppo.safetensors",
        "0f2b7f94aaa13fdcd7b1cd2bb2f55552dfc5c1990663a8c801126c8c4bdcd66f",
        "told where the next two gates are, without a camera; learnt to fly by PPO",
    ),
)


def names(application: str | None = None) -> tuple[str, ...]:
    """The shipped agents' names, of one application or of all."""
    return tuple(a.name for a in AGENTS if application in (None, a.application))


def card(name: str, application: str | None = None) -> AgentCard:
    """A shipped agent by name.

    Raises:
        ValueError: If there is none of that name, or it serves another application.
    """
    for agent in AGENTS:
        if agent.name == name and application in (None, agent.application):
            return agent
    known = names(application)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise UserError(f"Expected an agent's name among {', '.join(known)}, got {name!r}.{hint}")


def load_detector(agent: str | Path) -> Detector:
    """Load a shipped detector by name, or a safetensors file with its architecture's weights.

    Raises:
        ValueError: If there is no such agent or file, or the shipped file's SHA-256 is off.
    """
    from sada_gym.agents.detector.model import load
    from sada_gym.envs.detection.shapes.catalogue import CLASSES

    if isinstance(agent, str) and not agent.endswith(".safetensors"):
        shipped = card(agent, "SADA-Detection")
        verify(shipped)
        return load(shipped.path, CLASSES)
    if not Path(agent).is_file():
        raise UserError(f"Expected a file with a detector's weights, got {agent}: no such file.")
    return load(Path(agent), CLASSES)


def load_driver(agent: str) -> BaseAlgorithm:
    """Load a shipped driver by name.

    SB3's files hold pickles, so only those whose SHA-256 is known are opened.

    Raises:
        ValueError: If there is no such agent, or its file's SHA-256 is off.
    """
    from stable_baselines3 import PPO

    _refuse_zip(agent, f"a driver's name among {', '.join(names('SADA-Driving'))}")
    shipped = card(agent, "SADA-Driving")
    verify(shipped)
    with generators_kept():
        return PPO.load(shipped.path, device="cpu")


def load_pilot(agent: str | Path) -> WaypointNetwork | PPO:
    """Load a shipped pilot by name, or a safetensors file with one's weights.

    Raises:
        ValueError: If there is no such agent or file, the file holds something else, or the shipped
            file's SHA-256 is off.
    """
    from sada_gym.agents.pilot.weights import load

    _refuse_zip(
        agent, f"a pilot's name among {', '.join(names('SADA-UAV'))}, or a .safetensors file"
    )
    if isinstance(agent, str) and not agent.endswith(".safetensors"):
        shipped = card(agent, "SADA-UAV")
        verify(shipped)
        return load(shipped.path)
    if not Path(agent).is_file():
        raise UserError(f"Expected a file with a pilot's weights, got {agent}: no such file.")
    return load(Path(agent))


def _refuse_zip(agent: str | Path, expected: str) -> None:
    """Refuse SB3's files, which would be unpickled."""
    if str(agent).endswith(".zip"):
        raise UserError(
            f"Expected {expected}, got the file {agent}. SB3's files hold pickles, which can run "
            "code: load one that you trust yourself, and pass the model, agent=PPO.load(file)."
        )


def verify(agent: AgentCard) -> None:
    """Check that an agent's weights are those that the benchmark was measured with.

    Raises:
        ValueError: If the file is missing, or its SHA-256 differs from the recorded one.
    """
    if not agent.path.is_file():
        raise UserError(
            f"Expected the shipped weights in {agent.path}, got no such file. Install the package "
            "again, or pass your own file as agent=PATH."
        )
    found = hashlib.sha256(agent.path.read_bytes()).hexdigest()
    if found != agent.sha256:
        raise UserError(
            f"Expected {agent.path.name} with SHA-256 {agent.sha256[:12]}..., got {found[:12]}...: "
            "the shipped weights were changed. Install the package again, or pass your own file "
            "as agent=PATH."
        )


def fingerprint(agent: Any) -> str | None:
    """SHA-256 over a torch module's class and weights; None for what has no weights to hash."""
    import torch

    if not isinstance(agent, torch.nn.Module):
        return None
    digest = hashlib.sha256(f"{type(agent).__module__}.{type(agent).__qualname__}".encode())
    for name, value in sorted(agent.state_dict().items()):
        digest.update(f"{name}{tuple(value.shape)}{value.dtype}".encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
