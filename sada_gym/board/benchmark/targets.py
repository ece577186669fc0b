"""The targets of results as they are now: they show which results are outdated."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.errors import UserError
from sada_gym.experiment.target import OpenTarget
from sada_gym.measures.reference import FOLDER

Targets = Mapping[tuple[str, str], OpenTarget]
"""Targets that are closed again, by track and agent."""


def current_targets(keys: Collection[tuple[str, str]], references: Path = FOLDER) -> Targets:
    """Open and describe tracks with agents; those that are no longer there are left out."""
    targets = {}
    for track, agent in sorted(set(keys)):
        # a track or an agent may have been removed, or lie in a module that is not installed here
        with (
            suppress(UserError),
            OpenTarget.of(track, agent=agent, references=references) as target,
        ):
            _ = target.reference  # read while it is open
            targets[track, agent] = target
    return targets


def without_outdated(entries: Sequence[Entry], targets: Targets) -> tuple[list[Entry], int]:
    """Leave out the results that attack what is no longer there, and return how many those are."""

    def is_current(result: EntryResult) -> bool:
        attacked = result.claimed.experiment.target
        current = targets.get((attacked.track, attacked.agent))
        return current is not None and current.target == attacked

    kept = [entry.keeping(is_current) for entry in entries]
    results = zip(entries, kept, strict=True)
    return kept, sum(len(entry.results) - len(rest.results) for entry, rest in results)
