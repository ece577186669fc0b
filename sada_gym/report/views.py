"""What a page shows of a run: rates, weaknesses with pictures, figures, commands."""

from __future__ import annotations

import base64
import math
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from sada_gym.diagnosis.record import Rate, Weakness
from sada_gym.diagnosis.summary import rows as weakness_rows
from sada_gym.experiment.summary import summary_rows
from sada_gym.report.run import ReportedRun, highlights
from sada_gym.report.thumbnails import World, plot_of
from sada_gym.report.worlds import parameters_of

_MOST_VALUES, _MOST_TOLD = 8, 110
_PLOTS = {
    "sphere.png": "The samples around the object, seen from above",
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
class Picture:
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
class Finding:
    """A weakness: its text, the sentences on it, and failures of it."""

    text: str
    sentences: tuple[str, ...]
    pictures: tuple[Picture, ...]


class RunView:
    """What templates show of a run; `letter` tells it from the other one, if there are two."""

    def __init__(self, run: ReportedRun, letter: str = "") -> None:
        self.run, self.letter = run, letter
        self.settings, self.target = run.settings, run.target
        self.protocol, self.notes = run.settings.experiment.protocol, run.notes
        self.adversary = run.settings.label
        self.name = f"{letter}: {run.name}" if letter else run.name

    @cached_property
    def afr(self) -> NamedRate:
        """The attack fooling rate."""
        valid = self.run.samples.valid
        fooled = int(valid.fooled(self.target.fooling_threshold).sum())
        note = f"{fooled:,} of {len(valid):,} new worlds"
        return NamedRate(f"worlds of {self.adversary}", Rate.of(fooled, max(1, len(valid))), note)

    @cached_property
    def uniform(self) -> NamedRate | None:
        """How often uniform worlds fool the agent; None where it is not known."""
        name, result, reference = "uniform worlds", self.run.result, self.target.reference
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
        """The diagnosis in a sentence."""
        if self.run.diagnosis is not None:
            return self.run.diagnosis.sentence
        return "" if self.run.result is None else self.run.result.where.sentence

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The weaknesses; without any, one that has failures alone, if there are."""
        diagnosis, found = self.run.diagnosis, []
        for number, worlds in enumerate(highlights(self.run)):
            rule = self.run.rules[number] if self.run.rules else ()
            first = parameters_of(rule)
            pictures = tuple(self._picture(world, first) for world in worlds if self._has(world))
            text = " and ".join(condition.text for condition in rule)
            sentences: tuple[str, ...] = ()
            if diagnosis is not None and diagnosis.weaknesses:
                weakness = diagnosis.weaknesses[number]
                text, sentences = weakness.text, tuple(_sentences(weakness))
            if text or pictures:
                found.append(Finding(_heading(text), sentences, pictures))
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
        return [] if self.run.failures is None else list(self.run.failures.rows())

    @property
    def order(self) -> list[str]:
        """The parameters' names, those that matter most first."""
        names = self.run.space.names
        named = [name for rule in self.run.rules for name in parameters_of(rule)]
        if self.run.result is not None:
            named += [influence.parameter for influence in self.run.result.influences]
        return list(dict.fromkeys([*(name for name in named if name in names), *names]))

    @property
    def figures(self) -> list[tuple[str, str]]:
        """The lines of the attack's summary; none where result.json cannot be read."""
        if self.run.result is None:
            return []
        diagnosis = self.run.diagnosis
        where = () if diagnosis is None else weakness_rows(diagnosis)
        return list(summary_rows(self.run.result, where=where, space=self.run.space))

    @property
    def versions(self) -> dict[str, str]:
        """The versions of what took part."""
        return self.settings.packages

    @property
    def command(self) -> str:
        """What repeats the run from the working directory: a command, or a line of Python."""
        if self.run.columns.command:
            # the run's own folder is not free, and a page is the same wherever its run lies
            out = shlex.quote(f"{self.run.name}-again")
            return f"{self.run.columns.command} --out {out}"
        sizes = f"budget={self.protocol.budget}, samples={self.protocol.samples}"
        options = self.settings.experiment.adversary.options
        given = f", options={options!r}" if options else ""
        return (
            f"attack(application, {self.adversary!r}, {sizes}, seed={self.settings.seed}{given}, "
            f"out={f'{self.run.name}-again'!r})"
        )

    def _has(self, world: World) -> bool:
        return world.key in self.run.pictures

    def _picture(self, world: World, first: Sequence[str]) -> Picture:
        place = "" if world.row is None else f"Sample {world.row}: "
        told = self.run.told.get(-1 if world.row is None else world.row, "")
        title = f"{place}Q = {world.score:.2f}"
        space = self.run.space
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
        source = data_uri(self.run.pictures[world.key])
        return Picture(world.key, source, title, tuple(values), told)


def _heading(text: str) -> str:
    # x0 stays as it is: it is a name
    return text[:1].upper() + text[1:] if text.partition(" ")[0].isalpha() else text


def _sentences(weakness: Weakness) -> Iterator[str]:
    if not weakness.is_checked:
        yield "Not yet confirmed: too few fresh worlds say so clearly."
    if weakness.inside is not None:
        text = f"{_rate(weakness.inside)} of uniform worlds in it fool the agent"
        if weakness.outside is not None:
            text += f", and {_rate(weakness.outside)} elsewhere"
        yield f"{text}."
    groups = f", in {weakness.distinct} groups" if weakness.distinct > 1 else ""
    yield (
        f"It holds {_percent(weakness.share)} of all failures ({weakness.failures:,}{groups}) in "
        f"{_percent(weakness.volume)} of all worlds."
    )
    if weakness.confirmed is not None:
        yield f"{_rate(weakness.confirmed)} of them fail again on fresh seeds."
    if weakness.behaviour is not None:
        yield f"{_heading(weakness.behaviour)}."


def _rate(rate: Rate) -> str:
    low, high = rate.interval_95
    return f"{_percent(rate.rate)} ({100 * low:.0f} to {100 * high:.0f})"


def _percent(share: float) -> str:
    percent = 100 * share
    shown = f"{percent:.1f}" if 0.0 < percent < 1.0 else f"{math.floor(percent + 0.5)}"
    return f"{shown} %"


def data_uri(picture: bytes) -> str:
    """Write a WebP as an address that needs no request."""
    return f"data:image/webp;base64,{base64.b64encode(picture).decode()}"
