"""What a page shows of a run: rates, weaknesses with pictures, figures, commands."""

from __future__ import annotations

import base64
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sada_gym.analyses.plots.failure_choice import choose_failures
from sada_gym.analyses.report.thumbnails import PicturedWorld, plot_of, sample
from sada_gym.evaluations import Evaluations
from sada_gym.experiment.record import Protocol, RunReport, RunSettings
from sada_gym.experiment.target import Target
from sada_gym.foundations.figures import percent
from sada_gym.measures.diagnosis.record import Condition, Diagnosis, Example, Rate, Weakness
from sada_gym.measures.diagnosis.summary import rate_text
from sada_gym.measures.diagnosis.summary import rows as weakness_rows
from sada_gym.measures.failures import Failures
from sada_gym.parameters import ParameterSpace
from sada_gym.run import Run
from sada_gym.run.summary import summary_rows
from sada_gym.run.worlds import (
    ParameterColumn,
    WorldColumns,
    parameters_of,
    weakness_of,
    write_worlds,
)

_EACH = 3  # pictures of a weakness
_MOST_VALUES, _MOST_TOLD = 8, 110
_PLOTS = {
    "sphere.png": "The samples around the object, seen from above",
    "curves.png": "Over the episode: the band of the worlds that fail, and of those that pass",
    "influence.png": "The chance of failing along each parameter, and a map of the two that matter "
    "most with the samples on it",
}


@dataclass(frozen=True)
class NamedRate:
    """A line of the chart of rates."""

    name: str
    rate: Rate
    note: str

    @property
    def text(self) -> str:
        """The rate as people read it."""
        return f"{100 * self.rate.rate:.1f} %"

    @property
    def interval(self) -> str:
        """Its interval as people read it."""
        low, high = self.rate.interval_95
        return f"95 % interval {100 * low:.1f} to {100 * high:.1f}"


@dataclass(frozen=True)
class ReportPicture:
    """A picture on the first screen, with the physical values of its world.

    `told` says what the agent did there, and `brief` its beginning; both are empty where that is
    not known.
    """

    key: str
    source: str
    title: str
    values: tuple[str, ...]
    told: str

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
        note = f"{fooled:,} of {len(valid):,} new worlds"
        return NamedRate(f"worlds of {self.adversary}", Rate.of(fooled, max(1, len(valid))), note)

    @cached_property
    def uniform(self) -> NamedRate | None:
        """How often uniform worlds fool the agent; None where it is not known."""
        name, result, reference = "uniform worlds", self.result, self.target.reference
        if reference is not None and reference.points:
            rate = Rate.of(round(reference.uniform_rate * reference.points), reference.points)
            return NamedRate(name, rate, f"{reference.points:,} worlds of the reference set")
        if result is None or result.uniform is None or not result.uniform.worlds:
            return None
        found = result.uniform
        note = f"{found.fooled:,} of {found.worlds:,} training queries"
        return NamedRate(name, Rate.of(found.fooled, found.worlds), note)

    @property
    def rates(self) -> tuple[NamedRate, ...]:
        """The lines of the chart."""
        return (self.afr,) if self.uniform is None else (self.afr, self.uniform)

    @property
    def sentence(self) -> str:
        """The diagnosis in a sentence; empty where there is none."""
        return "" if self.diagnosis is None else self.diagnosis.sentence

    @cached_property
    def findings(self) -> tuple[ShownWeakness, ...]:
        """The weaknesses; without any, one that has failures alone, if there are."""
        diagnosis, found = self.diagnosis, []
        for number, worlds in enumerate(highlights(self)):
            rule = self.rules[number] if self.rules else ()
            first = parameters_of(rule)
            pictures = tuple(self._picture(world, first) for world in worlds if self._has(world))
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
        found = ((text, plot_of(self.run.folder / name)) for name, text in _PLOTS.items())
        return tuple((text, data_uri(plot)) for text, plot in found if plot is not None)

    @property
    def more(self) -> list[tuple[str, str]]:
        """What the agent does in its failures, and how sure they are."""
        return [] if self.failures is None else list(self.failures.rows())

    @property
    def likely(self) -> list[tuple[str, str]]:
        """How likely a failure is in ordinary use, where that was estimated."""
        found = self.run.estimate
        return [] if found is None else [*found.rows()][:1]

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
        """The lines of the attack's summary; none where result.json cannot be read."""
        if self.result is None:
            return []
        diagnosis = self.diagnosis
        where = () if diagnosis is None else weakness_rows(diagnosis)
        rows = summary_rows(self.result, where=where, space=self.space, likely=self.run.estimate)
        return list(rows)

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
        place = "" if world.row is None else f"Sample {world.row}: "
        told = self.told.get(-1 if world.row is None else world.row, "")
        title = f"{place}Q = {world.score:.2f}"
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
        return ReportPicture(world.key, source, title, tuple(values), told)


def highlights(view: RunView) -> list[list[PicturedWorld]]:
    """Choose up to three failures of each weakness; of no weakness, three failures."""
    if view.diagnosis is not None and view.diagnosis.weaknesses:
        return [
            [_example(one, view.samples) for one in weakness.examples[:_EACH]]
            for weakness in view.diagnosis.weaknesses
        ]
    samples, threshold = view.samples, view.target.fooling_threshold
    fooled = samples.fooled(threshold)
    if view.rules:
        fooled &= weakness_of(view.rules, view.space, samples.mu) == 1
    rows = np.flatnonzero(fooled)
    counts = (0, _EACH, 0)
    chosen = choose_failures(view.space, samples[rows], threshold, counts).typical
    return [[sample(samples, int(rows[one.sample])) for one in chosen]]


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
    if not weakness.is_checked:
        yield "Not yet confirmed: too few fresh worlds say so clearly."
    if weakness.inside is not None:
        text = f"{rate_text(weakness.inside)} of uniform worlds in it fool the agent"
        if weakness.outside is not None:
            text += f", and {rate_text(weakness.outside)} elsewhere"
        yield f"{text}."
    groups = f", in {weakness.distinct} groups" if weakness.distinct > 1 else ""
    yield (
        f"It holds {percent(weakness.share)} of all failures ({weakness.failures:,}{groups}) in "
        f"{percent(weakness.volume)} of all worlds."
    )
    if weakness.confirmed is not None:
        yield f"{rate_text(weakness.confirmed)} of them fail again on fresh seeds."
    if weakness.behaviour is not None:
        yield f"{_heading(weakness.behaviour)}."


def data_uri(picture: bytes) -> str:
    """Write a WebP as an address that needs no request."""
    return f"data:image/webp;base64,{base64.b64encode(picture).decode()}"
