"""The frozen agents that are shipped: one row an agent, and how to load one."""

from __future__ import annotations

import difflib
import hashlib
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from sada_gym.agents.identity import check_agent_id, fingerprint, identity, refuse_nonfinite
from sada_gym.errors import FileError, UserError

__all__ = [
    "AGENTS",
    "AgentCard",
    "card",
    "fingerprint",
    "identity",
    "load",
    "load_classifier",
    "load_detector",
    "load_driver",
    "load_pilot",
    "names",
    "refuse_nonfinite",
    "resolve",
    "verify",
]


@dataclass(frozen=True)
class AgentCard:
    """A shipped agent.

    Attributes:
        name: What `agent=` takes.
        application: The application that it serves.
        file: Its weights, relative to `sada_gym/envs`.
        sha256: Of that file; a file that differs is refused.
        summary: A line for people.
        loader: `module:function` that turns a file of weights into an agent of this application.
        kind: What such an agent is called in messages.
    """

    name: str
    application: str
    file: str
    sha256: str
    summary: str
    loader: str = ""
    kind: str = "agent"

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
        "sada_gym.envs.detection.agent.weights:load",
        "detector",
    ),
    AgentCard(
        "surveyor",
        "SADA-Detection",
        "detection/agent/surveyor.safetensors",
        "6c62a41b9911d7ba3f836d0a52c1a5f6ff2d3049dff255e66ce8c0b410624c3f",
        "the same with one training view in ten from everywhere",
        "sada_gym.envs.detection.agent.weights:load",
        "detector",
    ),
    AgentCard(
        "cil",
        "SADA-Driving",
        "driving/agent/cil.safetensors",
        "42cc4cf97217ce4ba45a4315cedf835677ed0f97d7653f5d901a60872ee40372",
        "imitates an expert, at the default camera in four weathers; the default",
        "sada_gym.envs.driving.agent.weights:load",
        "driver",
    ),
    AgentCard(
        "cil-augmented",
        "SADA-Driving",
        "driving/agent/cil-augmented.safetensors",
        "932d7d9d92d97d4e3e96acf907896cc4a96d0fbaaf6b893b986a65734ee1433c",
        "the same, with another camera each drive and stronger changes of the light",
        "sada_gym.envs.driving.agent.weights:load",
        "driver",
    ),
    AgentCard(
        "ppo",
        "SADA-Driving",
        "driving/agent/ppo.safetensors",
        "22e413aaaf7937a60be0d14f717f7c1f8a882cbdcf66d5bb7a1827f1432f6fa4",
        "cil, trained on by PPO on the driving task",
        "sada_gym.envs.driving.agent.weights:load",
        "driver",
    ),
    AgentCard(
        "waypoint-pid",
        "SADA-UAV",
        "uav/agent/waypoint-pid.safetensors",
        "c26fa779414358f7d365e858cde0633fc1df652e4b02c98b33df3c214379c9e6",
        "sees where the next gate is and flies there; trained on mild tracks; the default",
        "sada_gym.envs.uav.agent.weights:load",
        "pilot",
    ),
    AgentCard(
        "ppo",
        "SADA-UAV",
        "uav/agent/ppo.safetensors",
        "0f2b7f94aaa13fdcd7b1cd2bb2f55552dfc5c1990663a8c801126c8c4bdcd66f",
        "gets the places of the next two gates and no image; learnt to fly by PPO",
        "sada_gym.envs.uav.agent.weights:load",
        "pilot",
    ),
    AgentCard(
        "cnn",
        "SADA-Digits",
        "digits/agent/cnn.safetensors",
        "20310308027458ca18818a87c2c3b8d3bb544d0b454c2f36779d18bae9bfa9cc",
        "a small CNN, trained on 1,352 real digits; the default",
        "sada_gym.envs.digits.agent.weights:load",
        "classifier",
    ),
    AgentCard(
        "cnn",
        "SADA-Pixel",
        "digits/agent/cnn.safetensors",
        "20310308027458ca18818a87c2c3b8d3bb544d0b454c2f36779d18bae9bfa9cc",
        "the same classifier as of SADA-Digits; the default",
        "sada_gym.envs.digits.agent.weights:load",
        "classifier",
    ),
)


def names(application: str | None = None) -> tuple[str, ...]:
    """The shipped agents' names, of one application or of all."""
    return tuple(a.name for a in AGENTS if application in (None, a.application))


def card(name: str, application: str | None = None) -> AgentCard:
    """A shipped agent by name.

    Raises:
        UserError: If there is none of that name, or it serves another application.
    """
    for agent in AGENTS:
        if agent.name == name and application in (None, agent.application):
            return agent
    known = names(application)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise UserError(f"Expected an agent's name among {', '.join(known)}, got {name!r}.{hint}")


def load(agent: str | Path, application: str) -> Any:
    """Load a shipped agent by name, or a safetensors file with an agent's weights.

    Args:
        agent: A name, or a file, whose name ends in `.safetensors`.
        application: Such as `SADA-Driving`.

    Raises:
        UserError: If there is no such agent or file, the file is a zip, which would be unpickled,
            holds something else, or is shipped and its SHA-256 is off.
    """
    row = next(row for row in AGENTS if row.application == application)
    if str(agent).endswith(".zip"):
        raise UserError(
            f"Expected a {row.kind}'s name among {', '.join(names(application))}, or a "
            f".safetensors file, got the file {agent}. SB3's files hold pickles, which can run "
            "code: load one that you trust yourself, and pass the model, agent=PPO.load(file)."
        )
    if isinstance(agent, str) and not agent.endswith(".safetensors"):
        row = card(agent, application)
        verify(row)
        path = row.path
    else:
        path = Path(agent)
        if not path.is_file():
            raise FileError(
                f"Expected a file with a {row.kind}'s weights, got {agent}: no such file."
            )
    module, _, function = row.loader.partition(":")
    return getattr(import_module(module), function)(path)


# shorthands; agents of further applications are loaded by `load`
load_detector = partial(load, application="SADA-Detection")
"""`load` for detectors."""
load_driver = partial(load, application="SADA-Driving")
"""`load` for drivers."""
load_pilot = partial(load, application="SADA-UAV")
"""`load` for pilots."""
load_classifier = partial(load, application="SADA-Digits")
"""`load` for classifiers of digits."""


def resolve(agent: Any, application: str, agent_id: str | None) -> tuple[str, Any]:
    """The agent that an application's `agent=` means, and what reports call it.

    Args:
        agent: A shipped agent's name, a file, or the agent itself.
        application: The application's name.
        agent_id: The name that its owner gave it, if any.

    Raises:
        UserError: If there is no such agent or file, weights are not finite numbers, or `agent_id`
            is no name.
    """
    check_agent_id(agent_id)
    if isinstance(agent, str | Path):
        return str(agent), load(agent, application)
    refuse_nonfinite(agent)
    return agent_id or type(agent).__name__, agent


def verify(agent: AgentCard) -> None:
    """Check that an agent's weights are those that the benchmark was measured with.

    Raises:
        FileError: If the file is missing, or its SHA-256 differs from the recorded one.
    """
    if not agent.path.is_file():
        raise FileError(
            f"Expected the shipped weights in {agent.path}, got no such file. Install the package "
            "again, or pass your own file as agent=PATH."
        )
    found = hashlib.sha256(agent.path.read_bytes()).hexdigest()
    if found != agent.sha256:
        raise FileError(
            f"Expected {agent.path.name} with SHA-256 {agent.sha256[:12]}..., got {found[:12]}...: "
            "the shipped weights were changed. Install the package again, or pass your own file "
            "as agent=PATH."
        )
