"""The environments' ids, registered with Gymnasium when `sada_gym` is imported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

from sada_gym.foundations.cards import cards

_ENTRY_POINTS = ("sada_gym.envs:AdversaryEnv", "sada_gym.envs:AdversaryVectorEnv")


def register_environments() -> None:
    """Register the ids of all cards with Gymnasium; doing it again changes nothing."""
    for card in cards():
        for env_id, keywords in ids_of(card.name).items():
            _register(env_id, _ENTRY_POINTS, {"application": card.application, **keywords})
        for env_id, entry_points in card.tasks.items():
            _register(env_id, entry_points, {})


def _register(env_id: str, entry_points: tuple[str, str], kwargs: dict[str, Any]) -> None:
    if env_id not in gym.registry:
        env, vector_env = entry_points
        gym.register(env_id, entry_point=env, vector_entry_point=vector_env, kwargs=kwargs)


def ids_of(application: str | None = None) -> dict[str, Mapping[str, Any]]:
    """Return the ids of an application, or of all, with the keywords that each fixes."""
    ids: dict[str, Mapping[str, Any]] = {}
    for card in cards():
        if application in (None, card.name):
            ids[card.id] = {}
            ids |= {card.track_id(suffix): card.tracks[suffix] for suffix in card.tracks}
    return ids


def env_ids() -> tuple[str, ...]:
    """Return the ids of this package's adversary environments."""
    return tuple(ids_of())


def tracks(*, installed: bool = False) -> tuple[str, ...]:
    """Return the leaderboard's tracks; with `installed`, only those whose parts are installed."""
    chosen = (card for card in cards() if not (installed and card.missing))
    return tuple(env_id for card in chosen for env_id in card.track_ids)


def task_ids() -> tuple[str, ...]:
    """Return the ids of the inner tasks, on which the agents under attack are trained."""
    return tuple(env_id for card in cards() for env_id in card.tasks)
