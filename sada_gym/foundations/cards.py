"""The applications: one card each, from which ids, agents, suites, references and tests follow.

A card names modules by strings, so that reading the cards loads no simulator and no network.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from sada_gym.foundations.lazy import load

APPLICATIONS = (
    *("analytic", "detection", "driving", "uav", "robot", "digits", "pixel"),
    *("detection_coco", "carla", "quadrotor", "photos", "go2", "metadrive", "flight"),
)
"""The folders of the applications, in the order of all listings."""


@dataclass(frozen=True)
class AgentCard:
    """A shipped agent.

    Attributes:
        name: The name for `agent=`.
        file: The file of its weights, relative to `sada_gym/envs`.
        sha256: The SHA-256 of that file; a file that differs is refused.
        summary: What it is, in a few words.
        nominal: How well it does in nominal worlds, as its model card says.
        loader: The `module:function` that turns the file into the agent. If empty, the
            application's `agent_loader` does it.
    """

    name: str
    file: str
    sha256: str
    summary: str
    nominal: str
    loader: str = ""

    @property
    def path(self) -> Path:
        """Where the weights lie."""
        return Path(__file__).parents[1] / "envs" / self.file


@dataclass(frozen=True)
class FetchedAgent:
    """An agent that nobody here trained: `sada-gym fetch` gets it once, and nothing ships it.

    Attributes:
        name: What `agent=` takes.
        client: The program that gets its package: `npm` or `pip`.
        members: The SHA-256 of the package's files that are needed, by path in the archive.
        archive: The name that the archive has where the client writes it.
        converter: `module:function` that turns these files, path to content, into the content of
            the agent's own file.
        loader: `module:function` that turns that file into the agent.
        sha256: The SHA-256 of that file.
        nominal: How well it does, as its authors say.
        licence: As found beside the weights.
        megabytes: What has to be downloaded.
    """

    name: str
    client: str
    package: str
    version: str
    archive: str
    members: Mapping[str, str]
    converter: str
    loader: str
    sha256: str
    summary: str
    nominal: str
    licence: str
    megabytes: int


@dataclass(frozen=True)
class PackagedAgent:
    """An agent that nobody here trained, inside a package that the extra `zoo` installs.

    Attributes:
        name: What `agent=` takes.
        members: The SHA-256 of the package's files on which it depends, by path as pip lists them.
        loader: `module:function` that turns these files, a dictionary of paths by member, into the
            agent.
        nominal: How well it does in nominal worlds.
        licence: As found beside its files.
    """

    name: str
    package: str
    version: str
    members: Mapping[str, str]
    loader: str
    summary: str
    nominal: str
    licence: str

    @property
    def needs(self) -> dict[str, str]:
        """The version that its package must have, by the name that pip knows."""
        return {self.package: self.version}


@dataclass(frozen=True)
class SuiteCard:
    """The suite of an application's tracks in `sada-gym benchmark`.

    Attributes:
        tracks: The suffixes of the tracks that take part; empty for all.
        tables: The names of its tables: `paper-budgets`, `equal-queries`. The first of them,
            with the default agent, is the comparison that the overviews show.
        seeds_of: Other numbers of seeds than `seeds` for some tracks, by suffix.
        images: Samples whose neighbours are compared as images too, on the first seed; 0 for none.
        overview: Whether pages that compare all applications show it.
        adversaries: The rows of its tables, by label; empty for all of ours.
    """

    name: str
    tracks: tuple[str, ...] = ()
    tables: tuple[str, ...] = ("paper-budgets",)
    seeds: int = 1
    seeds_of: Mapping[str, int] = field(default_factory=dict)
    images: int = 4
    overview: bool = True
    adversaries: tuple[str, ...] = ()


def small_suite(name: str, *controls: str, tracks: tuple[str, ...] = ()) -> SuiteCard:
    """Return the suite of an application whose worlds are slow: one adversary of each kind.

    `controls` are rows beside them; `tracks` are the suffixes of those that take part, or all.
    """
    kinds = ("random", "gmm50", "gp", "bbgan", "bbgan-boost", "trees", "level-set")
    rows = (*controls, *kinds)
    return SuiteCard(name, tracks, ("equal-queries",), images=0, overview=False, adversaries=rows)


@dataclass(frozen=True)
class ApplicationCard:
    """All that the rest of the package knows of an application.

    Attributes:
        name: The general id without its version, such as `SADA-Detection`.
        summary: A sentence on what the adversary changes and what the agent has to do.
        application: `module:class` of the `Application`.
        requirements: `module:function` that says in a sentence which parts have to be installed
            before its ids work, empty where all are there; empty where none are needed.
        repeatable: Whether a score repeats to the last bit. Others never take part in the
            benchmark and on the leaderboard.
        tracks: The keywords that each track of the leaderboard fixes, by what its id adds to the
            name, such as `Car`.
        same_as: The suffix of the track that the general id is by default; None where it is none.
        agents: The agents that are shipped for it, the default first.
        fetched: The agents that `sada-gym fetch` gets for it.
        packaged: The agents inside installed packages; the first is the default.
        agent_sources: `module:function` that loads what `agent="SOURCE:NAME"` names, by source.
        agent_kind: What its agents are called in messages, such as `detector`.
        agent_loader: `module:function` that turns a file of weights into an agent.
        tasks: The environments on which its agents are trained: by id, `module:class` of the scalar
            environment and of the batch.
        packages: The packages that a score can depend on, beside those of every run.
        reference_points: The number of Sobol points in the reference set of a track, scrambled by
            `sobol_seed`; each is evaluated `reference_seeds` times.
    """

    name: str
    title: str
    summary: str
    application: str
    requirements: str = ""
    repeatable: bool = True
    version: int = 0
    tracks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    same_as: str | None = None
    agents: tuple[AgentCard, ...] = ()
    fetched: tuple[FetchedAgent, ...] = ()
    packaged: tuple[PackagedAgent, ...] = ()
    agent_sources: Mapping[str, str] = field(default_factory=dict)
    agent_kind: str = "agent"
    agent_loader: str = ""
    tasks: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    reference_points: int = 4_000
    reference_seeds: int = 3
    sobol_seed: int = 0
    suite: SuiteCard | None = None

    @property
    def missing(self) -> str:
        """What has to be installed before its ids work, as a sentence; empty where all is there."""
        return str(load(self.requirements)()) if self.requirements else ""

    @property
    def all_agents(self) -> tuple[AgentCard | FetchedAgent | PackagedAgent, ...]:
        """All agents that have a name."""
        return (*self.packaged, *self.agents, *self.fetched)

    @property
    def offered(self) -> tuple[AgentCard | FetchedAgent | PackagedAgent, ...]:
        """The agents that its tables compare, the default first.

        Fetched ones are among them where there are no others.
        """
        return (*self.packaged, *self.agents) or self.fetched

    @property
    def id(self) -> str:
        """The general id."""
        return f"{self.name}-v{self.version}"

    def track_id(self, suffix: str) -> str:
        """Return the id of a track."""
        return f"{self.name}-{suffix}-v{self.version}"

    @property
    def track_ids(self) -> tuple[str, ...]:
        """The ids of all tracks."""
        return tuple(map(self.track_id, self.tracks))

    @property
    def board_tracks(self) -> tuple[str, ...]:
        """The ids that take part in the leaderboard: without tracks the general one."""
        return (self.track_ids or (self.id,)) if self.repeatable else ()

    @property
    def page(self) -> str:
        """The name of its page of the leaderboard: its suite's, if it has one."""
        return self.suite.name if self.suite else self.name.removeprefix("SADA-").lower()

    def short(self, track: str) -> str:
        """Return what tells a track from the others."""
        if track == self.id:
            return self.title
        return track.removeprefix(f"{self.name}-").rsplit("-v", 1)[0]


@cache
def cards() -> tuple[ApplicationCard, ...]:
    """Return the cards of all applications."""
    return tuple(load(f"sada_gym.envs.{folder}.card:CARD") for folder in APPLICATIONS)


def fetchable(application: str | None = None) -> dict[str, FetchedAgent]:
    """Return the agents that `fetch` can get, by name, for one application or for all."""
    chosen = (card for card in cards() if application in (None, card.name))
    return {agent.name: agent for card in chosen for agent in card.fetched}


def find_card(name: str) -> ApplicationCard | None:
    """Find the card of an application by its name; None where it is no application of ours."""
    return next((card for card in cards() if card.name == name), None)
