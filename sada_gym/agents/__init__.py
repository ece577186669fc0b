"""The frozen agents that are shipped: their names, files and SHA-256, and how to load them."""

from __future__ import annotations

import difflib
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sada_gym.errors import UserError

if TYPE_CHECKING:
    from stable_baselines3 import PPO

    from sada_gym.envs.detection.agent.network import Detector
    from sada_gym.envs.uav.agent.network import WaypointNetwork


@dataclass(frozen=True)
class AgentCard:
    """A shipped agent.

    Attributes:
        name: What `agent=` takes.
        application: The applications that it serves.
        file: Its weights, relative to `sada_gym/envs`.
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
        return Path(__file__).parents[1] / "envs" / self.file


AGENTS = (
    AgentCard(
        "photographer",
        "SADA-Detection",
        "detection/agent/photographer.safetensors",
        "9a7ec7022a5388f2692c60a08b404d9f20f2cc67a08f4a652b61f2cf6648b016",
        "detector trained on the views that people photograph; the default",
    ),
    AgentCard(
        "surveyor",
        "SADA-Detection",
        "detection/agent/surveyor.safetensors",
        "6c62a41b9911d7ba3f836d0a52c1a5f6ff2d3049dff255e66ce8c0b410624c3f",
        "the same with one training view in ten from everywhere",
    ),
    AgentCard(
        "cil",
        "SADA-Driving",
        "driving/agent/cil.safetensors",
        "42cc4cf97217ce4ba45a4315cedf835677ed0f97d7653f5d901a60872ee40372",
        "imitates an expert, at the default camera in four weathers; the default",
    ),
    AgentCard(
        "cil-augmented",
        "SADA-Driving",
        "driving/agent/cil-augmented.safetensors",
        "932d7d9d92d97d4e3e96acf907896cc4a96d0fbaaf6b893b986a65734ee1433c",
        "the same, with another camera each drive and stronger changes of the light",
    ),
    AgentCard(
        "ppo",
        "SADA-Driving",
        "driving/agent/ppo.safetensors",
        "22e413aaaf7937a60be0d14f717f7c1f8a882cbdcf66d5bb7a1827f1432f6fa4",
        "cil, trained on by PPO on the driving task",
    ),
    AgentCard(
        "waypoint-pid",
        "SADA-UAV",
        "uav/agent/waypoint-pid.safetensors",
        "c26fa779414358f7d365e858cde0633fc1df652e4b02c98b33df3c214379c9e6",
        "sees where the next gate is and flies there; trained on mild tracks; the default",
    ),
    AgentCard(
        "ppo",
        "SADA-UAV",
        "uav/agent/ppo.safetensors",
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
    from sada_gym.envs.detection.agent.network import load
    from sada_gym.envs.detection.shapes.catalogue import CLASSES

    return load(_file(agent, "SADA-Detection", "detector"), CLASSES)


def load_driver(agent: str | Path) -> PPO:
    """Load a shipped driver by name, or a safetensors file with one's weights.

    Raises:
        ValueError: If there is no such agent or file, the file holds something else, or the shipped
            file's SHA-256 is off.
    """
    from sada_gym.envs.driving.agent.weights import load

    return load(_file(agent, "SADA-Driving", "driver"))


def load_pilot(agent: str | Path) -> WaypointNetwork | PPO:
    """Load a shipped pilot by name, or a safetensors file with one's weights.

    Raises:
        ValueError: If there is no such agent or file, the file holds something else, or the shipped
            file's SHA-256 is off.
    """
    from sada_gym.envs.uav.agent.weights import load

    return load(_file(agent, "SADA-UAV", "pilot"))


def _file(agent: str | Path, application: str, kind: str) -> Path:
    """The file of a shipped agent, whose SHA-256 is checked, or a safetensors file of a user's.

    Raises:
        ValueError: If there is no such agent or file, or it is a zip, which would be unpickled.
    """
    if str(agent).endswith(".zip"):
        raise UserError(
            f"Expected a {kind}'s name among {', '.join(names(application))}, or a .safetensors "
            f"file, got the file {agent}. SB3's files hold pickles, which can run code: load one "
            "that you trust yourself, and pass the model, agent=PPO.load(file)."
        )
    if isinstance(agent, str) and not agent.endswith(".safetensors"):
        shipped = card(agent, application)
        verify(shipped)
        return shipped.path
    if not Path(agent).is_file():
        raise UserError(f"Expected a file with a {kind}'s weights, got {agent}: no such file.")
    return Path(agent)


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
    kind = type(agent)
    name = getattr(kind, "fingerprint_name", f"{kind.__module__}.{kind.__qualname__}")
    digest = hashlib.sha256(name.encode())
    for name, value in sorted(agent.state_dict().items()):
        digest.update(f"{name}{tuple(value.shape)}{value.dtype}".encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
