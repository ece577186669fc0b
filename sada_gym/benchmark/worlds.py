"""The worlds that results attack, as they are today: they show which results are outdated."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sada_gym.errors import UserError
from sada_gym.evaluation.store import Context
from sada_gym.experiment.assemble import RunTarget, open_application
from sada_gym.measures.reference import FOLDER, load_reference
from sada_gym.parameters import Mu, ParameterSpace
from sada_gym.submission.entry import Entry, EntryResult
from sada_gym.submission.models import Identity

_TARGET = {
    "application",
    "version",
    "application_settings",
    "fingerprint",
    "fooling_threshold",
    "reference",
}


@dataclass(frozen=True, eq=False)
class World:
    """What is attacked on a track with an agent.

    Attributes:
        target: The fields of the `Identity` of a result that name it.
        parameters: The semantic parameters.
        fooling_set: The points of the reference set that fool, (m, d); None where there are too
            few.
    """

    target: dict[str, Any]
    parameters: ParameterSpace
    fooling_set: Mu | None

    def is_of(self, identity: Identity) -> bool:
        """Say whether a result attacks this world."""
        return identity.model_dump(mode="json", include=_TARGET) == self.target


def open_worlds(
    keys: Collection[tuple[str, str]], references: Path = FOLDER
) -> dict[tuple[str, str], World]:
    """Open tracks with agents, and describe them; those that are no longer there are left out.

    Args:
        keys: The track and the agent of each.
        references: The folder of the reference sets.
    """
    worlds = {}
    for track, agent in sorted(set(keys)):
        # a track or an agent may have been removed, or lie in a module that is not installed here
        with suppress(UserError):
            worlds[track, agent] = _open_world(track, agent, references)
    return worlds


def _open_world(track: str, agent: str, references: Path) -> World:
    with closing(open_application(track, agent)) as application:
        reference = load_reference(track, application, references)
        summary = RunTarget(track, application, reference).summary
        usable = reference is not None and summary is not None and summary.usable
        context = Context.of(application)
        return World(
            target={
                "application": context.name,
                "version": context.version,
                "application_settings": json.loads(context.settings),
                "fingerprint": context.fingerprint,
                "fooling_threshold": float(application.fooling_threshold),
                "reference": None if summary is None else summary.model_dump(mode="json"),
            },
            parameters=application.parameters,
            fooling_set=reference.fooling_set if usable and reference is not None else None,
        )


def without_outdated(
    entries: Sequence[Entry], worlds: dict[tuple[str, str], World]
) -> tuple[list[Entry], int]:
    """Leave out the results that attack what is no longer there.

    Args:
        entries: The entries.
        worlds: What there is, by track and agent.

    Returns:
        The entries with the other results, and the number of results that were left out.
    """

    def is_there(result: EntryResult) -> bool:
        identity = result.claimed.identity
        world = worlds.get((identity.track, identity.agent))
        return world is not None and world.is_of(identity)

    kept, left_out = [], 0
    for entry in entries:
        there = entry.keeping(is_there)
        left_out += len(entry.results) - len(there.results)
        kept.append(there)
    return kept, left_out
