"""The frozen agents that are shipped, collected from the applications' cards."""

from __future__ import annotations

import difflib
import hashlib
import os
from pathlib import Path
from typing import Any

from sada_gym.agents.identity import check_agent_id, check_finite_weights, fingerprint, identity
from sada_gym.cards import AgentCard, FetchedAgent, cards, fetchable, find_card
from sada_gym.errors import FileError, UserError
from sada_gym.lazy import load as load_object

_WEIGHTS = ".safetensors"

__all__ = [
    "AgentCard",
    "card",
    "check_agent",
    "check_finite_weights",
    "fingerprint",
    "identity",
    "load",
    "names",
    "resolve",
    "verify",
]


def names(application: str | None = None) -> tuple[str, ...]:
    """List the names of the shipped agents, of one application or of all.

    An application that ships none is attacked with the agents that are fetched for it.
    """
    chosen = [card for card in cards() if application in (None, card.name)]
    return tuple(agent.name for card in chosen for agent in card.agents or card.fetched)


def card(name: str, application: str | None = None) -> AgentCard:
    """Find a shipped agent by name.

    Raises:
        UserError: If there is none of that name, or it serves another application.
    """
    for agent in _agent_cards(application):
        if agent.name == name:
            return agent
    known = names(application)
    raise UserError(
        f"Expected an agent's name among {', '.join(known)}, got {name!r}.{_hint(name, known)}"
    )


def load(agent: str | Path, application: str) -> Any:
    """Load a shipped or a fetched agent by name, or a safetensors file with an agent's weights.

    Args:
        agent: A name, or a file, whose name ends in `.safetensors`, or `SOURCE:NAME` for an
            application that has such sources.
        application: The name of the application that the agent is for, such as `SADA-Driving`.

    Raises:
        UserError: If the application ships no agents, or there is no such agent or file, or the
            file is a zip, which would be unpickled, holds something else, or is shipped and its
            SHA-256 is off.
    """
    application_card = find_card(application)
    if application_card is None or not application_card.agent_loader:
        loading = ", ".join(card.name for card in cards() if card.agent_loader)
        raise UserError(
            f"Expected an application that loads agents from files, one of {loading}, got "
            f"{application!r}. Pass the agent itself."
        )
    check_agent(agent, application)
    path, loader = Path(agent), application_card.agent_loader
    source, _, name = str(agent).partition(":")
    if source in application_card.agent_sources:
        return load_object(application_card.agent_sources[source])(name)
    if agent in (others := fetchable(application)):
        return load_object(others[str(agent)].loader)(_fetched(others[str(agent)]))
    if isinstance(agent, str) and not agent.endswith(_WEIGHTS):
        shipped = card(agent, application)
        verify(shipped)
        path, loader = shipped.path, shipped.loader or loader
    return load_object(loader)(path)


def _fetched(agent: FetchedAgent) -> Path:
    path: Path = load_object("sada_gym.fetch:fetched")(agent)  # which needs pydantic
    return path


def check_agent(agent: str | Path, application: str) -> None:
    """Check that `load` would find an agent, without loading a network.

    Args:
        agent: A name or a file, as `load` takes it.
        application: The name of the application that the agent is for.

    Raises:
        UserError: If there is no such agent or file, or the file is of another kind, or the agent
            still has to be fetched.
    """
    others = fetchable(application)
    known, path = tuple(dict.fromkeys((*names(application), *others))), Path(agent)
    if agent in others:
        _fetched(others[str(agent)])
        return
    if isinstance(agent, str) and agent in known:
        return
    application_card = find_card(application)
    if application_card and str(agent).partition(":")[0] in application_card.agent_sources:
        return
    kind = "agent" if application_card is None else application_card.agent_kind
    expected = f"Expected an agent's name among {', '.join(known)}, or a {_WEIGHTS} file"
    exists = os.path.isfile(agent)  # of any text: pathlib raises for one that is too long
    if str(agent).endswith(".zip"):
        raise UserError(
            f"{expected}, got the file {agent}. SB3's files hold pickles, which can run code: load "
            "one that you trust yourself, and pass the model, agent=PPO.load(file)."
        )
    if exists and isinstance(agent, str) and not agent.endswith(_WEIGHTS):
        raise UserError(
            f"{expected}, got the file {agent}. Other files may hold pickles, which can run code: "
            f"load one that you trust in Python, and pass the {kind} itself, agent=..."
        )
    if not exists and (path.suffix or len(path.parts) > 1):
        raise FileError(
            f"{expected} with a {kind}'s weights, got {agent}: no such file. Check its path."
        )
    if not exists:
        raise UserError(f"{expected}, got {str(agent)!r}.{_hint(str(agent), known)}")


def _agent_cards(application: str | None) -> list[AgentCard]:
    chosen = [card for card in cards() if application in (None, card.name)]
    return [agent for card in chosen for agent in card.agents]


def _hint(name: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def resolve(agent: Any, application: str, agent_id: str | None) -> tuple[str, Any]:
    """Return what reports call the agent that an application's `agent=` means, and the agent.

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
    check_finite_weights(agent)
    return agent_id or str(getattr(agent, "__name__", type(agent).__name__)), agent


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
    sha256 = hashlib.sha256(agent.path.read_bytes()).hexdigest()
    if sha256 != agent.sha256:
        raise FileError(
            f"Expected {agent.path.name} with SHA-256 {agent.sha256[:12]}..., got "
            f"{sha256[:12]}...: the shipped weights were changed. Install the package again, or "
            "pass your own file as agent=PATH."
        )
