"""The tracks of an application, and what the entries hold on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sada_gym.benchmark.results import Results
from sada_gym.cards import ApplicationCard
from sada_gym.experiment.record import slug
from sada_gym.results.entry import Entry, EntryResult
from sada_gym.results.models import Tier


@dataclass(frozen=True)
class TrackGroup:
    """The tracks of one application: a page of the board, called `name`.

    Attributes:
        agents: The agents that are shipped for it, the default first, each with its summary.
        nominal: How well each of them does in nominal worlds.
    """

    name: str
    title: str
    summary: str
    application: str
    tracks: tuple[str, ...]
    agents: Mapping[str, str]
    nominal: Mapping[str, str]

    @classmethod
    def of(cls, card: ApplicationCard) -> TrackGroup:
        """Take a group from an application's card."""
        name = card.suite.name if card.suite else slug(card.name.removeprefix("SADA-")).lower()
        agents = {agent.name: agent.summary for agent in card.agents}
        nominal = {agent.name: agent.nominal for agent in card.agents}
        tracks = card.track_ids or (card.id,)
        return cls(name, card.title, card.summary, card.name, tracks, agents, nominal)

    def short(self, track: str) -> str:
        """Return what tells a track from the others of its group."""
        return track.removeprefix(f"{self.application}-").rsplit("-v", 1)[0]


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
    """What the entries hold on the tracks of one group.

    Attributes:
        entries: The entries with those of their results that are of this group and today's.
        results: What the results sum up to, by tier.
    """

    group: TrackGroup
    entries: tuple[Entry, ...]
    results: Mapping[Tier, Results]
    outdated: tuple[OutdatedResult, ...]
