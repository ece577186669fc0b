"""What the entries hold on the tracks of an application."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sada_gym.benchmark.results import Results
from sada_gym.cards import ApplicationCard
from sada_gym.results.entry import Entry, EntryResult
from sada_gym.results.models import Tier


def track_of(result: EntryResult) -> str:
    """Return the id of the track that a result is on."""
    return result.claimed.experiment.target.track


@dataclass(frozen=True, eq=False)
class OutdatedResult:
    """A result of an entry that no longer compares with others: what differs from today's."""

    entry: Entry
    result: EntryResult
    reason: str


@dataclass(frozen=True, eq=False)
class GroupResults:
    """What the entries hold on the tracks of one application: a page of the board.

    Attributes:
        entries: The entries with those of their results that are of this group and today's.
        results: What the results sum up to, by tier.
    """

    card: ApplicationCard
    entries: tuple[Entry, ...]
    results: Mapping[Tier, Results]
    outdated: tuple[OutdatedResult, ...]
