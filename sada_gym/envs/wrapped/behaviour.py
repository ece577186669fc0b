"""What an agent did in any Gymnasium environment: when its episodes ended, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sada_gym.envs.wrapped.episodes import RunningEpisode
from sada_gym.envs.wrapped.several import EDGE
from sada_gym.evaluations import fools
from sada_gym.foundations.behaviour import MOST_NAMED, Behaviour, Plain, listed_events, plain_values
from sada_gym.foundations.figures import number

_GOOD = ("is_success", "success", "TimeLimit.truncated")
"""What an info may say to be true where nothing went wrong."""


def behaviour(episodes: Sequence[RunningEpisode], threshold: float) -> Behaviour:
    """Say how the episodes of one world, which have ended, did so."""
    each = [_data(episode) for episode in episodes]
    failed = [bool(episode.broken) or fools(episode.score, threshold) for episode in episodes]
    events = [
        (f"episode {i}: {_text(data, episode)}", _event(episode))
        for i, (data, episode, fails) in enumerate(zip(each, episodes, failed, strict=True), 1)
        if fails
    ]
    if len(episodes) == 1:
        told = tuple(event for _, event in events)
        return Behaviour(_text(each[0], episodes[0]), told, data=each[0])
    fine = f"none of {len(episodes)} episodes failed"
    text, told = listed_events(events, len(episodes), "episode", fine)
    return Behaviour(text, told, "episode", mean_values(each))


def _data(episode: RunningEpisode) -> dict[str, Plain]:
    ended = {
        "steps": len(episode.rewards),
        "return": float(sum(episode.rewards)),
    }
    margins = {f"margin of {name}": value for name, value in episode.margins.items()}
    return {**ended, **margins, **plain_values(episode.info, "info ")}


def _event(episode: RunningEpisode) -> str:
    """Say which requirements failed together, or else how the episode ended."""
    failed = [name for name, value in episode.margins.items() if fools(value, EDGE)]
    return f"fails {' and '.join(failed)}" if failed else _ending(episode)


def _ending(episode: RunningEpisode) -> str:
    if episode.broken:
        return f"broken: {episode.broken}"
    ended = "terminated" if episode.terminated else "truncated"
    true = [key for key, value in plain_values(episode.info).items() if value is True]
    named = [key for key in true if key not in _GOOD][:MOST_NAMED]
    return ", ".join([ended, *named])


def _text(data: dict[str, Plain], episode: RunningEpisode) -> str:
    total = number(float(data["return"]))
    event, ending = _event(episode), _ending(episode)
    said = ending if event == ending else f"{event}: {ending}"
    return f"{said} after {data['steps']} steps, return {total}"


def mean_values(each: Sequence[Mapping[str, Plain]]) -> dict[str, Plain]:
    """Return the mean of numbers, the share of truth values, and texts that are all the same."""
    joined: dict[str, Plain] = {}
    for name in each[0]:
        values: list[Any] = [data.get(name) for data in each]
        if all(isinstance(value, int | float) for value in values):
            joined[name] = float(np.mean(values))
        elif len(set(values)) == 1:
            joined[name] = values[0]
    return joined
