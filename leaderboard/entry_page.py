"""What the page of an entry shows: who made it, its figures by track and seed, and its flags."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from leaderboard.board import TIERS, Board, GroupBoard
from leaderboard.board_tables import outdated_sheet
from leaderboard.pictures import Picture, Pictures
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import slug
from sada_gym.results.entry import Entry, EntryResult
from sada_gym.results.models import EntryMetadata, Tier
from sada_gym.results.rows import Row
from sada_gym.results.sheet import Cell, Column, Line, Sheet, number_cell, rate_cell, text_cell

_COLUMNS = (
    Column("track", "Track", numeric=False),
    Column("tier", "Tier", numeric=False),
    Column("afr_verified", "AFR verified, %", "By us on fresh seeds, with its 95 % interval."),
    Column("afr_claimed", "AFR claimed, %", "The submitter's own figure."),
    Column("seeds", "AFR of each seed, %", "In the order of the seeds.", numeric=False),
    Column("relative_verified", "Coverage / ideal verified, %"),
    Column("relative_claimed", "Coverage / ideal claimed, %"),
    Column("queries", "Queries", "Training queries a run; this is the submitter's word."),
    Column("mu_std", "μ_std"),
)


@dataclass(frozen=True)
class Flag:
    """Something that a reader must know.

    Attributes:
        name: The verifier's name for it; empty for what the submitter's own runs say.
        texts: Its sentences, each with the tracks and seeds that it is said of.
    """

    name: str
    texts: Mapping[str, tuple[str, ...]]

    @property
    def count(self) -> int:
        """The number of results or seeds that it is said of."""
        return sum(len(places) for places in self.texts.values())


@dataclass(frozen=True)
class Section:
    """An entry's results in one comparison.

    Attributes:
        title: What is compared.
        href: The comparison on its group's page.
        sheet: The figures of each track.
        pictures: Where its samples lie, and worlds that fool the agent.
    """

    title: str
    href: str
    sheet: Sheet
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class EntryPage:
    """The page of an entry.

    Attributes:
        about: Who made it.
        tiers: The tiers that its results have.
        options: Its options, as indented JSON.
        links: Its links by what they lead to; only those to web pages.
        sections: Its results.
        flags: What a reader must know.
        outdated: The table of its outdated results; None where it has none.
        failures: The runs that ended with an error.
    """

    metadata: EntryMetadata
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
        adversary=adversary,
        tiers=tuple(t for t in TIERS if any(one.tier == t for one in entry.results.values())),
        options=_options(adversary.options if adversary is not None else {}),
        links={name: url for name, url in links.items() if is_web(url)},
        sections=tuple(
            section for group in board.groups for section in _sections(group, entry, pictures)
        ),
        flags=tuple(_flags(entry)),
        outdated=outdated_sheet(f"entries/{metadata.name}", outdated) if outdated else None,
        failures=_failures(entry),
    )


def is_web(url: str) -> bool:
    """Say whether an address leads to a web page; a page links to nothing else."""
    return url.startswith(("https://", "http://"))


def _options(options: Mapping[str, Any]) -> str:
    return json.dumps(options, indent=2, ensure_ascii=False) if options else ""


def _sections(board: GroupBoard, entry: Entry, pictures: Pictures) -> Iterator[Section]:
    own = next((one for one in board.entries if one.metadata.name == entry.metadata.name), None)
    if own is None:
        return
    for comparison in board.comparisons:
        table, agent = comparison.table, comparison.agent
        rows = {
            tier: {
                row.track: row
                for track in board.group.tracks
                for row in board.results[tier].rows_of(table.name, agent, track)
                if row.entry == entry.metadata.name
            }
            for tier in TIERS
        }
        held = {
            attacked.target.track: result
            for result in own.results.values()
            for attacked in [result.claimed.experiment]
            if (attacked.target.agent, attacked.protocol.rule) == (agent, table.name)
        }
        results = {track: held[track] for track in board.group.tracks if track in held}
        if not rows["claimed"]:
            continue
        name = f"entries/{entry.metadata.name}.{slug(board.group.name)}.{comparison.anchor}"
        against = f" · {agent}" if agent else ""
        yield Section(
            f"{board.group.title} · {table.title}{against}",
            f"{board.group.name}.html#{comparison.anchor}",
            Sheet(name, "By track", _COLUMNS, tuple(_lines(results, rows))),
            pictures.of(board.group, agent, results),
        )


def _lines(
    results: Mapping[str, EntryResult], rows: Mapping[Tier, Mapping[str | None, Row]]
) -> Iterator[Line]:
    for track, result in results.items():
        verified, claimed = (rows[tier].get(track) for tier in TIERS)
        seeds: Sequence[float | None] = (
            [one.measures.afr for one in result.verified.seeds]
            if result.verified is not None
            else [one.measures.afr if one.measures else None for one in result.claimed.seeds]
        )
        texts = ["failed" if rate is None else f"{100 * rate:.1f}" for rate in seeds]
        shown = verified or claimed
        cells = {
            "track": text_cell(track),
            "tier": text_cell(result.tier),
            "afr_verified": rate_cell(verified.afr if verified else None),
            "afr_claimed": rate_cell(claimed.afr if claimed else None),
            "seeds": text_cell(", ".join(texts)),
            "relative_verified": rate_cell(verified.relative_coverage if verified else None),
            "relative_claimed": rate_cell(claimed.relative_coverage if claimed else None),
            "queries": number_cell(shown.queries) if shown else Cell(),
            "mu_std": number_cell(shown.mu_std, 3) if shown else Cell(),
        }
        yield Line("ranked", cells)


def _flags(entry: Entry) -> Iterator[Flag]:
    found: dict[str, dict[str, tuple[str, ...]]] = {}

    def add(name: str, text: str, where: str) -> None:
        texts = found.setdefault(name, {})
        texts[text] = (*texts.get(text, ()), where)

    for result in entry.results.values():
        if result.verified is not None:
            for name, text in result.verified.flags.items():
                add(name, text, _where(result))
        for seed in result.claimed.seeds:
            for text in seed.flags:
                add("", text, f"{_where(result)}, seed {seed.seed}")
    for name in sorted(found, key=lambda name: (name == "", name)):
        yield Flag(name, found[name])


def _failures(entry: Entry) -> Flag:
    texts: dict[str, tuple[str, ...]] = {}
    for result in entry.results.values():
        for seed in result.claimed.seeds:
            if seed.error is not None:
                where = f"{_where(result)}, seed {seed.seed}"
                texts[seed.error] = (*texts.get(seed.error, ()), where)
    return Flag("", texts)


def _where(result: EntryResult) -> str:
    experiment = result.claimed.experiment
    return f"{experiment.target}, {experiment.protocol.rule}"
