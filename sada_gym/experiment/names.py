"""Refuses misspelt names of a run before any simulator or network is imported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sada_gym import adversaries, agents
from sada_gym.errors import check_known
from sada_gym.foundations.cards import ApplicationCard, cards
from sada_gym.foundations.ids import find_spec, names_file

IDEAL = "ideal"  #: The name of the control that knows the answer.


def check_spelling(environment: object, adversary: object, env_kwargs: Mapping[str, Any]) -> None:
    """Raise a ValueError for an unknown id, adversary or agent, or a missing file of weights.

    What is given as an object is left to later checks, and so are a TOML file and `module:Class`.
    """
    if isinstance(environment, str) and not names_file(environment):
        card = card_of(environment)
        agent = env_kwargs.get("agent")
        if card is not None and card.agent_loader and isinstance(agent, str):
            agents.check_agent(agent, card.name)
    if isinstance(adversary, str) and adversary != IDEAL and ":" not in adversary:
        check_known("adversary", [adversary], adversaries.names())


def card_of(env_id: str) -> ApplicationCard | None:
    """Find the card of an id's application, None if not ours; a ValueError for an unknown id."""
    application = find_spec(env_id).kwargs.get("application")
    return next((card for card in cards() if card.application == application), None)


def default_note(environment: object, env_kwargs: Mapping[str, Any]) -> str | None:
    """Say which track a general id takes where its keyword is left out; None where none is."""
    if not isinstance(environment, str) or names_file(environment):
        return None
    card = card_of(environment)
    if card is None or card.same_as is None or environment.rpartition(":")[2] != card.id:
        return None
    left_out = {k: v for k, v in card.tracks[card.same_as].items() if k not in env_kwargs}
    if not left_out:
        return None
    taken = ", ".join(f"{name}={value}" for name, value in left_out.items())
    return (
        f"{card.id} without {' and '.join(left_out)} takes {taken}, as "
        f"{card.track_id(card.same_as)} does. `sada-gym envs` lists the others."
    )
