"""What a page shows of a run: rates, weaknesses with pictures, figures, commands."""

from __future__ import annotations

import base64
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from itertools import islice

import numpy as np

from sada_gym.analyses.plots.attack import FOR_PAGES
from sada_gym.analyses.plots.failure_choice import choose_failures
from sada_gym.analyses.report.thumbnails import PicturedWorld, sample
from sada_gym.evaluations import Evaluations, fools
from sada_gym.experiment.record import Protocol, RunReport, RunSettings
from sada_gym.experiment.target import Target
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.figures import percent
from sada_gym.measures.diagnosis.record import Condition, Diagnosis, Example, Rate, Weakness
from sada_gym.measures.diagnosis.summary import figures
from sada_gym.measures.failures import Failures
from sada_gym.parameters import ParameterSpace
from sada_gym.run import Run
from sada_gym.run.folder import SETTINGS_FILE
from sada_gym.run.summary import RATES, WHERE, uniform_rate
from sada_gym.run.worlds import (
    ParameterColumn,
    WorldColumns,
    parameters_of,
    write_worlds,
)

_EACH = 2  # failures of a weakness that are pictured
_MOST_PLOT_BYTES = 1_000_000
_MOST_VALUES, _MOST_TOLD = 8, 110
_PLOTS = (
    "The samples around the object, seen from above",
    "Over the episode: the band of the worlds that fail, and of those that pass",
    "The chance of failing along each parameter, and a map of the two that matter most with the "
    "samples on it",
)


@dataclass(frozen=True)
class NamedRate:
    """A line of the chart of rates; `found` marks those of worlds that the adversary made."""

    name: str
    rate: Rate
    note: str
    found: bool = False

    @property
    def text(self) -> str:
        """The rate as people read it."""
        return percent(self.rate.rate)

    @property
    def interval(self) -> str:
        """Its interval as people read it."""
        low, high = self.rate.interval_95
        return f"95 % interval {100 * low:.0f} to {100 * high:.0f}"


@dataclass(frozen=True)
class ReportPicture:
    """A picture on the first screen, with the physical values of its world.

    `told` says what the agent did there, and `brief` its beginning; both are empty where that is
    not known. A film strip has several pictures of an episode.
    """

    key: str
    source: str
    title: str
    values: tuple[str, ...]
    told: str
    is_film: bool = False

    @property
    def brief(self) -> str:
        """As much of `told` as a caption has room for."""
        return textwrap.shorten(self.told, _MOST_TOLD, placeholder=" …")


@dataclass(frozen=True)
class ShownWeakness:
    """A weakness: its text, the sentences on it, and failures of it."""

    text: str
    sentences: tuple[str, ...]
    pictures: tuple[ReportPicture, ...]


@dataclass(frozen=True)
class RunView:
    """What a page shows of a run, of which parts may be missing or of another version.

    Attributes:
        result: Its figures; None where another version wrote result.json.
        diagnosis: None where there is none.
        failures: The list of failures; None where there is none.
        queries: The training queries; none where run.sqlite does not tell them.
        pictures: Small pictures of worlds, WebP, by `PicturedWorld.key`.
        notes: What a reader must know of the report itself.
        letter: Tells the run from the other one, if there are two.
    """

    run: Run
    result: RunReport | None
    diagnosis: Diagnosis | None
    failures: Failures | None
    queries: Evaluations
    columns: WorldColumns
    pictures: Mapping[str, bytes]
    notes: tuple[str, ...] = ()
    letter: str = ""

    @property
    def settings(self) -> RunSettings:
        """The run's settings."""
        return self.run.settings

    @property
    def samples(self) -> Evaluations:
        """The run's test samples."""
        return self.run.samples

    @property
    def target(self) -> Target:
        """What was attacked."""
        return self.run.target

    @property
    def protocol(self) -> Protocol:
        """The numbers of queries and samples."""
        return self.settings.experiment.protocol

    @property
    def adversary(self) -> str:
        """What reports call the adversary."""
        return self.settings.label

    @property
    def name(self) -> str:
        """The name of the run's folder, behind the letter."""
        return f"{self.letter}: {self.run.name}" if self.letter else self.run.name

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return self.columns.space

    @cached_property
    def behaviours(self) -> dict[int, str]:
        """What the agent did, by the sample's row, where it is known."""
        listed = () if self.failures is None else self.failures.failures
        return {one.sample: one.behaviour for one in listed if one.behaviour}

    @cached_property
    def told(self) -> dict[int, str]:
        """The same, and on how many fresh seeds the failure came again, where that was tried."""
        told = {}
        for one in () if self.failures is None else self.failures.failures:
            parts = [one.behaviour] if one.behaviour else []
            if one.valid_seeds:
                parts.append(f"fails again on {one.fooled_seeds} of {one.valid_seeds} fresh seeds")
            if parts:
                told[one.sample] = "; ".join(parts)
        return told

    @property
    def rules(self) -> tuple[tuple[Condition, ...], ...]:
        """The conditions of each weakness."""
        weaknesses = () if self.diagnosis is None else self.diagnosis.weaknesses
        return tuple(weakness.conditions for weakness in weaknesses)

    def write_worlds(self) -> None:
        """Write worlds.csv and worlds.json into the folder; nothing where no name is known."""
        if self.columns == mu_alone(len(self.columns.parameters)):
            return
        threshold = self.target.fooling_threshold
        written = (self.columns, self.samples, self.queries, threshold, self.rules)
        write_worlds(self.run.folder, *written, self.behaviours)

    @cached_property
    def afr(self) -> NamedRate:
        """The attack fooling rate."""
        valid = self.samples.valid
        fooled = int(valid.fooled(self.target.fooling_threshold).sum())
        name = f"worlds that {self.adversary} makes"
        rate = Rate.of(fooled, max(1, len(valid)))
        return NamedRate(name, rate, f"{len(valid):,} new ones", found=True)

    @cached_property
    def rates(self) -> tuple[NamedRate, ...]:
        """The lines of the chart: as it is, in all worlds, in the adversary's, and again."""
        lines, result, failures = [], self.result, self.failures
        if result is not None and (nominal := result.nominal) is not None:
            rate = Rate.of(nominal.fooled, nominal.evaluations)
            lines.append(NamedRate("as it is", rate, f"{nominal.evaluations} nominal episodes"))
        if result is not None and (even := uniform_rate(result)) is not None:
            lines.append(NamedRate("all worlds in the ranges", even, f"{even.samples:,} worlds"))
        lines.append(self.afr)
        if failures is not None and failures.confirmed is not None:
            note = f"{failures.confirmed.samples} tried on {failures.seeds} fresh seeds each"
            lines.append(NamedRate("failures that repeat", failures.confirmed, note, found=True))
        return tuple(lines)

    @property
    def agent(self) -> str:
        """The agent's name or file."""
        return self.run.given.agent or self.target.agent or "the agent"

    @property
    def title(self) -> str:
        """What the page is about, such as `Object detection: where photographer fails`."""
        card = find_card(self.target.application.name)
        where = f"where {self.agent} fails"
        return f"W{where[1:]}" if card is None else f"{card.title}: {where}"

    @property
    def date(self) -> str:
        """The day on which the run began, of which the folder alone knows."""
        moment = (self.run.folder / SETTINGS_FILE).stat().st_mtime
        return f"{datetime.fromtimestamp(moment, timezone.utc):%d %B %Y}".lstrip("0")

    @property
    def sentence(self) -> str:
        """What was found, in a sentence or two."""
        if self.diagnosis is not None:
            return self.diagnosis.sentence
        return f"Fails in {self.afr.text} of the {self.afr.name}."

    @cached_property
    def findings(self) -> tuple[ShownWeakness, ...]:
        """The weaknesses; without any, one that has failures alone, if there are."""
        diagnosis, found = self.diagnosis, []
        for number, worlds in enumerate(highlights(self)):
            rule = self.rules[number] if self.rules else ()
            first = parameters_of(rule)
            films = [world for world in worlds if world.is_film and self._has(world)]
            chosen = films or [world for world in worlds if self._has(world)]
            pictures = tuple(self._picture(world, first) for world in chosen)
            text = " and ".join(condition.text for condition in rule)
            sentences: tuple[str, ...] = ()
            if diagnosis is not None and diagnosis.weaknesses:
                weakness = diagnosis.weaknesses[number]
                text, sentences = weakness.text, tuple(_sentences(weakness))
            if text or pictures:
                found.append(ShownWeakness(_heading(text), sentences, pictures))
        return tuple(found)

    @cached_property
    def shown(self) -> dict[str, str]:
        """The ids of the pictures on the first screen, by the worlds' keys."""
        keys = dict.fromkeys(p.key for finding in self.findings for p in finding.pictures)
        return {key: f"{self.letter}p{i}" for i, key in enumerate(keys)}

    @cached_property
    def plots(self) -> tuple[tuple[str, str], ...]:
        """What the run's plots show of where it fails, and their sources; those that there are."""
        found = []
        for name, text in zip(FOR_PAGES, _PLOTS, strict=True):
            path = (self.run.folder / name).with_suffix(".svg")
            if path.is_file() and path.stat().st_size <= _MOST_PLOT_BYTES:
                found.append((text, data_uri(path.read_bytes(), "svg+xml")))
        return tuple(found)

    @property
    def order(self) -> list[str]:
        """The parameters' names, those that matter most first."""
        names = self.space.names
        named = [name for rule in self.rules for name in parameters_of(rule)]
        if self.result is not None:
            named += [influence.parameter for influence in self.result.influences]
        return list(dict.fromkeys([*(name for name in named if name in names), *names]))

    @property
    def figures(self) -> list[tuple[str, str]]:
        """The rows of the attack's summary that stand nowhere else on the page."""
        rows = [] if self.result is None else [*self.run.rows()]
        return [(name, text) for name, text in rows if name not in (RATES, WHERE)]

    @property
    def place(self) -> str:
        """Where a command finds the run from the folder in which it was made, as far as known."""
        folder = self.run.folder
        return self.run.name if folder.is_absolute() else str(folder)

    @property
    def steps(self) -> list[str]:
        """What to do next: two commands."""
        return [] if self.result is None else [*islice(self.run.commands(self.place), 2)]

    @property
    def versions(self) -> dict[str, str]:
        """The versions of what took part."""
        return self.settings.packages

    @property
    def command(self) -> str:
        """What repeats the run from the working directory: a command, or a line of Python."""
        if self.columns.command:
            # the run's own folder is not free, and a page is the same wherever its run lies
            out = shlex.quote(f"{self.run.name}-again")
            return f"{self.columns.command} --out {out}"
        sizes = f"budget={self.protocol.budget}, samples={self.protocol.samples}"
        options = self.settings.experiment.adversary.options
        given = f", options={options!r}" if options else ""
        return (
            f"attack(application, {self.adversary!r}, {sizes}, seed={self.settings.seed}{given}, "
            f"out={f'{self.run.name}-again'!r})"
        )

    def _has(self, world: PicturedWorld) -> bool:
        return world.key in self.pictures

    def _picture(self, world: PicturedWorld, first: Sequence[str]) -> ReportPicture:
        place = "" if world.row is None else f"sample {world.row}, "
        told = self.told.get(-1 if world.row is None else world.row, "")
        fails = fools(world.score, self.target.fooling_threshold)
        title = f"{'Fails' if fails else 'Passes'}: {place}Q = {world.score:.2f}"
        space = self.space
        texts = {
            parameter.name: parameter.text(value)
            for parameter, value in zip(
                space.parameters, space.physical(world.mu).tolist(), strict=True
            )
        }
        order = dict.fromkeys([*first, *self.order])
        values = [texts[name] for name in order if name in texts]
        if len(values) > _MOST_VALUES:
            values[_MOST_VALUES:] = [f"and {len(values) - _MOST_VALUES} more"]
        source = data_uri(self.pictures[world.key])
        return ReportPicture(world.key, source, title, tuple(values), told, world.is_film)


def highlights(view: RunView) -> list[list[PicturedWorld]]:
    """Choose two failures of each weakness, and the nearest world that passes; as films, too.

    Without weaknesses these are two failures and such a world.
    """
    samples, threshold = view.samples, view.target.fooling_threshold
    if view.diagnosis is not None and view.diagnosis.weaknesses:
        chosen = [
            [_example(one, samples) for one in weakness.examples[:_EACH]]
            for weakness in view.diagnosis.weaknesses
        ]
    else:
        rows = np.flatnonzero(samples.fooled(threshold))
        found = choose_failures(view.space, samples[rows], threshold, (0, _EACH, 0)).typical
        chosen = [[sample(samples, int(rows[one.sample])) for one in found]]
    return [_beside_a_pass(view, failures) for failures in chosen if failures]


def _beside_a_pass(view: RunView, failures: list[PicturedWorld]) -> list[PicturedWorld]:
    """Add the known world nearest to the first failure that passes, and the films of both."""
    known = Evaluations.joined([view.samples, view.queries])
    passes = np.flatnonzero(~known.fooled(view.target.fooling_threshold) & ~known.invalid)
    if not len(passes):
        return [replace(failures[0], is_film=True), *failures]
    far = np.abs(known.mu[passes] - failures[0].mu).sum(axis=1)
    row = int(passes[far.argmin()])
    near = replace(sample(known, row), row=row if row < len(view.samples) else None)
    return [replace(one, is_film=True) for one in (failures[0], near)] + [*failures, near]


def _example(example: Example, samples: Evaluations) -> PicturedWorld:
    mu = np.array(example.mu, np.float32)
    rows = np.flatnonzero((samples.seed == example.seed) & (samples.mu == mu).all(axis=1))
    return PicturedWorld(mu, example.seed, example.score, int(rows[0]) if len(rows) else None)


def mu_alone(dimension: int) -> WorldColumns:
    """Describe worlds whose parameters nothing names."""
    names = [f"mu {i}" for i in range(1, dimension + 1)]
    return WorldColumns(
        parameters=tuple(
            ParameterColumn(column=name, name=name, low=-1.0, high=1.0) for name in names
        )
    )


def _heading(text: str) -> str:
    # x0 stays as it is: it is a name
    return text[:1].upper() + text[1:] if text.partition(" ")[0].isalpha() else text


def _sentences(weakness: Weakness) -> Iterator[str]:
    yield from figures(weakness)
    groups = f", in {weakness.distinct} separate regions" if weakness.distinct > 1 else ""
    yield f"{percent(weakness.volume)} of all worlds; {weakness.failures:,} failures{groups}"


def data_uri(picture: bytes, kind: str = "webp") -> str:
    """Write a picture as an address that needs no request."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"
