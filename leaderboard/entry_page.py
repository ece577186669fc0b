"""What the page of an entry shows: who made it, its figures by track and seed, and its flags."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from leaderboard.board import TIERS, Board, GroupBoard
from leaderboard.board_tables import outdated_sheet
from leaderboard.pictures import Pictures, SamplePicture
from sada_gym.adversaries import registry
from sada_gym.board.benchmark.plan import AUTHORS
from sada_gym.board.results.columns import row_cells, row_columns
from sada_gym.board.results.entry import Entry, EntryResult
from sada_gym.board.results.models import EntryMetadata, SeedResult, Tier, VerifiedSeed
from sada_gym.board.results.rows import Row
from sada_gym.board.results.sheet import Column, Line, Sheet, text_cell, text_column
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import place_of, slug

_COLUMNS = (
    text_column("track"),
    text_column("tier"),
    Column("afr_verified", "AFR verified, %", "By us on fresh seeds, with its 95 % interval."),
    Column("afr_claimed", "AFR claimed, %", "The submitter's own figure."),
    text_column("seeds", "AFR of each seed, %", hint="In the order of the seeds."),
    Column("relative_verified", "coverage / ideal verified, %"),
    Column("relative_claimed", "coverage / ideal claimed, %"),
    *row_columns("queries", "mu_std"),
)


@dataclass(frozen=True)
class Flag:
    """What a reader must know: its sentences, each with the tracks and seeds that it is about.

    `name` is the verifier's; it is empty for what the submitter's own runs say.
    """

    name: str
    texts: Mapping[str, tuple[str, ...]]

    @property
    def count(self) -> int:
        """The number of results or seeds that it is said of."""
        return sum(len(places) for places in self.texts.values())


@dataclass(frozen=True)
class Section:
    """An entry's results in one comparison, to which `href` leads."""

    title: str
    href: str
    sheet: Sheet
    pictures: tuple[SamplePicture, ...]


@dataclass(frozen=True)
class EntryPage:
    """The page of an entry; `links` holds those to web pages alone."""

    metadata: EntryMetadata
    description: str
    by: str
    adversary: AdversarySpec | None
    tiers: tuple[Tier, ...]
    options: str
    links: Mapping[str, str]
    sections: tuple[Section, ...]
    flags: tuple[Flag, ...]
    outdated: Sheet | None
    failures: Flag

    @property
    def path(self) -> str:
        """The page's place in the site."""
        return f"entries/{self.metadata.name}.html"


def entry_page(board: Board, entry: Entry, pictures: Pictures) -> EntryPage:
    """Put an entry's page together."""
    metadata, adversary = entry.metadata, entry.adversary
    outdated = [late for late in board.outdated if late.entry.metadata.name == metadata.name]
    links = {"Paper": metadata.paper, "Repository": metadata.repository}
    return EntryPage(
        metadata=metadata,
        description=describe(entry),
        by=made_by(entry),
        adversary=adversary,
        tiers=tuple(t for t in TIERS if t in {result.tier for result in entry.results.values()}),
        options=json.dumps(adversary.options, indent=2, ensure_ascii=False)
        if adversary is not None and adversary.options
        else "",
        links={name: url for name, url in links.items() if is_web(url)},
        sections=tuple(
            section for group in board.groups for section in _sections(group, entry, pictures)
        ),
        flags=tuple(_flags(entry)),
        outdated=outdated_sheet(f"entries/{metadata.name}", outdated) if outdated else None,
        failures=_flag("", ((seed.error, place) for place, seed in _seeds(entry) if seed.error)),
    )


def describe(entry: Entry) -> str:
    """Say what an entry's adversary does: its own words, or of a baseline those of its class."""
    metadata = entry.metadata
    if metadata.description or metadata.authors != AUTHORS or entry.adversary is None:
        return metadata.description
    return _summaries().get(entry.adversary.name, "")


@cache
def _summaries() -> dict[str, str]:
    """Say what each of our adversaries does; it loads them all."""
    return {row.name: row.summary.replace("`", "") for row in registry.describe()}


def made_by(entry: Entry) -> str:
    """Name an entry's authors; those of the developers are baselines."""
    authors = entry.metadata.authors
    return "the developers' baseline" if authors == AUTHORS else ", ".join(authors)


def is_web(url: str) -> bool:
    """Whether an address leads to a web page; a page links to nothing else."""
    return url.startswith(("https://", "http://"))


def _sections(board: GroupBoard, entry: Entry, pictures: Pictures) -> Iterator[Section]:
    name, card = entry.metadata.name, board.card
    own = {other.metadata.name: other.results for other in board.entries}.get(name, {})
    for comparison, _ in board.comparisons if own else ():
        rule, agent = comparison.table.name, comparison.agent
        rows = {
            tier: {
                track: row
                for track in card.board_tracks
                for row in board.results[tier].rows_of(rule, agent, track)
                if row.entry == name
            }
            for tier in TIERS
        }
        places = {track: place_of(track, agent, rule) for track in card.board_tracks}
        results = {track: own[place] for track, place in places.items() if place in own}
        if rows["claimed"]:
            sheet = f"entries/{name}.{slug(card.page)}.{comparison.name}"
            yield Section(
                " · ".join((card.title, *comparison.names)),
                f"{card.page}.html#{comparison.name}",
                Sheet(sheet, "By track", _COLUMNS, tuple(_lines(results, rows))),
                pictures.of(card, agent, results),
            )


def _lines(
    results: Mapping[str, EntryResult], rows: Mapping[Tier, Mapping[str, Row]]
) -> Iterator[Line]:
    for track, result in results.items():
        seeds: Sequence[VerifiedSeed | SeedResult] = (result.verified or result.claimed).seeds
        texts = [f"{100 * s.measures.afr:.1f}" if s.measures else "failed" for s in seeds]
        cells = {
            "track": text_cell(track),
            "tier": text_cell(result.tier),
            "seeds": text_cell(", ".join(texts)),
        }
        for tier in ("claimed", "verified"):
            if row := rows[tier].get(track):
                of_row = row_cells(row, ("afr", "relative_coverage", "queries", "mu_std"))
                cells[f"afr_{tier}"] = of_row.pop("afr")
                cells[f"relative_{tier}"] = of_row.pop("relative_coverage")
                cells |= of_row
        yield Line("ranked", cells)


def _flags(entry: Entry) -> Iterator[Flag]:
    """List the verifier's flags by name, then what the submitter's own runs say."""
    flags = [
        (name, text, _where(result))
        for result in entry.results.values()
        if result.verified is not None
        for name, text in result.verified.flags.items()
    ]
    flags += [("", text, place) for place, seed in _seeds(entry) for text in seed.flags]
    for name in sorted({name for name, _, _ in flags}, key=lambda name: (name == "", name)):
        yield _flag(name, ((text, place) for other, text, place in flags if other == name))


def _seeds(entry: Entry) -> Iterator[tuple[str, SeedResult]]:
    for result in entry.results.values():
        for seed in result.claimed.seeds:
            yield f"{_where(result)}, seed {seed.seed}", seed


def _flag(name: str, sentences: Iterable[tuple[str, str]]) -> Flag:
    """Put the places together that each sentence is about."""
    places: dict[str, tuple[str, ...]] = {}
    for text, place in sentences:
        places[text] = (*places.get(text, ()), place)
    return Flag(name, places)


def _where(result: EntryResult) -> str:
    experiment = result.experiment
    return f"{experiment.target}, {experiment.protocol.rule}"
