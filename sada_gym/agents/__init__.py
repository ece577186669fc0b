"""The frozen agents that are shipped, collected from the applications' cards."""

from __future__ import annotations

import difflib
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sada_gym.agents.identity import check_agent_id, check_finite_weights, fingerprint, identity
from sada_gym.agents.packaged import package_files
from sada_gym.errors import FileError, UserError
from sada_gym.foundations.cards import AgentCard, cards, fetchable, find_card
from sada_gym.foundations.lazy import load as load_object

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
    """List the names of the shipped agents, the default first, for one application or for all.

    For an application that ships none, these are the agents that `fetch` can get.
    """
    chosen = [card for card in cards() if application in (None, card.name)]
    return tuple(agent.name for card in chosen for agent in card.offered)


def card(name: str, application: str | None = None) -> AgentCard:
    """Return a shipped agent's card by name; raise `UserError` if the application has none such."""
    chosen = [card for card in cards() if application in (None, card.name)]
    shipped = {agent.name: agent for card in chosen for agent in card.agents}
    if name not in shipped:
        raise _unknown(name, [*shipped])
    return shipped[name]


def load(agent: str | Path, application: str) -> Any:
    """Load an agent by name (shipped, fetched, or from another package), or a safetensors file.

    Args:
        agent: A name, a file of weights that ends in `.safetensors`, or `SOURCE:NAME` (such as
            `torchvision:NAME` for detection).
        application: The name of the application that the agent is for, such as `SADA-Driving`.

    Raises:
        UserError: If the application loads no agents, or there is no such agent or file; if the
            file is a zip (which would be unpickled) or holds something else; or if its SHA-256
            differs from the known one.
    """
    loader, source = _located(agent, application)
    return load_object(loader)(source)


def check_agent(agent: str | Path, application: str) -> None:
    """Raise what `load` would raise for an agent that it cannot find, without loading a network."""
    _located(agent, application)


def _located(agent: str | Path, application: str) -> tuple[str, Any]:
    """Return `module:function` that loads an agent, and what it loads it from."""
    card = find_card(application)
    if card is None or not (card.agent_loader or card.all_agents):
        loading = ", ".join(card.name for card in cards() if card.agent_loader or card.all_agents)
        raise UserError(
            f"Expected an application that loads agents, one of {loading}, got {application!r}. "
            "Pass the agent itself."
        )
    source, _, name = str(agent).partition(":")
    if source in card.agent_sources:
        return card.agent_sources[source], name
    others, shipped = fetchable(application), {row.name: row for row in card.agents}
    if agent in others:
        fetched = load_object("sada_gym.foundations.fetch:fetched")  # which needs pydantic
        return others[str(agent)].loader, fetched(others[str(agent)])
    packaged = {row.name: row for row in card.packaged}
    if agent in packaged:
        return packaged[str(agent)].loader, package_files(packaged[str(agent)])
    if agent in shipped:
        verify(shipped[str(agent)])
        return shipped[str(agent)].loader or card.agent_loader, shipped[str(agent)].path
    known = [*dict.fromkeys((*names(application), *others))]
    if not card.agent_loader:
        sources = "".join(f", {source}:NAME" for source in card.agent_sources)
        raise _unknown(str(agent), known, f"{sources}, or the {card.agent_kind} itself")
    expected = f"Expected an agent's name among {', '.join(known)}, or a {_WEIGHTS} file"
    exists, path = os.path.isfile(agent), Path(agent)  # pathlib raises where a name is too long
    if str(agent).endswith(".zip"):
        raise UserError(
            f"{expected}, got the file {agent}. SB3's files hold pickles, which can run code: load "
            "one that you trust yourself, and pass the model, agent=PPO.load(file)."
        )
    if exists and isinstance(agent, str) and not agent.endswith(_WEIGHTS):
        raise UserError(
            f"{expected}, got the file {agent}. Other files may hold pickles, which can run code: "
            f"load one that you trust in Python, and pass the {card.agent_kind} itself, agent=..."
        )
    if exists:
        return card.agent_loader, path
    if path.suffix or len(path.parts) > 1:
        raise FileError(
            f"{expected} with a {card.agent_kind}'s weights, got {agent}: no such file. Check its "
            "path."
        )
    raise _unknown(str(agent), known, f", or a {_WEIGHTS} file")


def _unknown(name: str, known: Sequence[str], otherwise: str = "") -> UserError:
    close = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return UserError(
        f"Expected an agent's name among {', '.join(known)}{otherwise}, got {name!r}.{hint}"
    )


def resolve(agent: Any, application: str, agent_id: str | None) -> tuple[str, Any]:
    """Turn an application's `agent=` into the agent's name in reports, and the agent itself.

    Args:
        agent: A shipped agent's name, a file, or the agent itself.
        application: The application's name.
        agent_id: The name that the user gave it, if any.

    Raises:
        UserError: If there is no such agent or file, if weights are not finite numbers, or if
            `agent_id` is not a valid name.
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
    is_there = agent.path.is_file()
    sha256 = hashlib.sha256(agent.path.read_bytes()).hexdigest() if is_there else "no such file"
    if sha256 != agent.sha256:
        raise FileError(
            f"Expected {agent.path} with SHA-256 {agent.sha256[:12]}..., got {sha256[:12]}: the "
            "shipped weights were changed. Install the package again, or pass your own file as "
            "agent=PATH."
        )
