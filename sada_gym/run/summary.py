"""The summary of an attack for people: how often the agent failed, where, and what to do next."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from sada_gym.experiment.invalid import InvalidWorlds
from sada_gym.experiment.measure import FeasibleRate
from sada_gym.experiment.nominal import Combined, NominalWorld
from sada_gym.experiment.record import FailureProbability, RunReport
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.figures import number, percent, tenths
from sada_gym.measures.diagnosis.record import Diagnosis
from sada_gym.measures.diagnosis.summary import rate_text, weakness_lines
from sada_gym.measures.failures import Failures
from sada_gym.measures.likelihood import FailureEstimate
from sada_gym.measures.rates import Rate
from sada_gym.measures.sensitivity import Influence
from sada_gym.parameters import ParameterSpace

WIDTH = 80
"""Lines of a summary are no longer, unless a word or a command is."""
RATES, WHERE = "fails in", "where"

_ALL_HELD = 0.995
_FEW_DRAWS = 30
_MOST_CHANGES = 2


def title(report: RunReport, agent: str = "") -> str:
    """Name a run: the agent, maybe as it was given, what it acts in, and the adversary."""
    target = report.settings.experiment.target
    acting = agent or target.agent or "the agent"
    return f"{acting} in {target.track}{_world(report)}, attacked by {report.settings.label}"


def summary_rows(
    report: RunReport,
    *,
    diagnosis: Diagnosis | None,
    failures: Failures | None,
    space: ParameterSpace | None = None,
    likely: FailureEstimate | None = None,
) -> Iterator[tuple[str, str]]:
    """Yield the name and the text, of one or more lines, of each finding.

    With the parameters' `space` values are written as people say them: by labels, units and
    choices. An estimate says how `likely` a failure is.
    """
    values = _Values(space)
    yield RATES, "\n".join(_rates(report, failures))
    weaknesses = () if diagnosis is None else diagnosis.weaknesses
    if diagnosis is not None:
        yield WHERE, "\n".join(weakness_lines(diagnosis))
    behaviours = None if failures is None else failures.behaviours
    if behaviours is not None and all(one.behaviour is None for one in weaknesses):
        yield "what it does", behaviours.sentence
    yield from _requirements(report)
    if report.influences:
        yield "what matters", _influences(report.influences, values)
    if report.nominal is not None and not report.nominal.fooled * 2 > report.nominal.evaluations:
        yield "nearest failure", _nearest(report.nominal, values)
    if report.nominal is not None and report.nominal.combined is not None:
        yield "combinations", _combined(report.nominal.combined, values)
    if report.nominal is not None and report.nominal.beside_budget is not None:
        beside = f"{report.nominal.beside_budget:,} evaluations of the nominal world and around it"
        yield "beyond the budget", beside
    if likely is not None:
        yield from likely.rows()
    elif report.in_use is not None:
        yield "in ordinary use", _in_use(report.in_use)
    if report.feasible is not None:
        yield "feasible worlds", _feasible(report.feasible, report.fooled)
    if report.invalid is not None:
        yield "invalid worlds", _invalid(report.invalid, report, values)
    for flag in report.flags:
        yield "warning", flag


def laid_out(rows: Iterable[tuple[str, str]], width: int = WIDTH) -> Iterator[tuple[str, str, str]]:
    """Yield the lines of rows as a name in the left column, which may be empty, and the text.

    With each line comes its row's name. Texts break between words, commands not at all; in a
    narrow space they stand below their names.
    """
    listed = list(rows)
    indent = 4 + max(len(name) for name, _ in listed)
    narrow = width < 2 * indent
    for name, text in listed:
        lead = f"  {name}".ljust(indent)
        if narrow:
            yield name, lead.rstrip(), ""
            indent, lead = 4, "    "
        for line in text.splitlines():
            inner = " " * (len(line) - len(line.lstrip()))
            hanging = inner + " " * 3 * bool(re.match(r"\d+\. ", line))
            wrapped = textwrap.TextWrapper(max(20, width - indent), inner, hanging)
            wrapped.break_long_words = wrapped.break_on_hyphens = False
            is_command = line.startswith(("sada-gym ", "sada_gym."))
            for part in [line] if is_command else wrapped.wrap(line.lstrip()):
                yield name, lead, part
                lead = " " * indent


def uniform_rate(report: RunReport) -> Rate | None:
    """Return how often uniform worlds fool the agent; None where it is not known."""
    reference, uniform = report.settings.experiment.target.reference, report.uniform
    if reference is not None and reference.points:
        return Rate.of(round(reference.uniform_rate * reference.points), reference.points)
    if report.settings.experiment.adversary.name == "random":
        return attack_rate(report)
    return Rate.of(uniform.fooled, uniform.worlds) if uniform and uniform.worlds else None


def attack_rate(report: RunReport) -> Rate:
    """Return the attack fooling rate, over the samples in valid worlds."""
    samples = report.settings.experiment.protocol.samples
    invalid = 0 if report.invalid is None else report.invalid.samples
    return Rate.of(report.fooled, max(1, samples - invalid))


def _rates(report: RunReport, failures: Failures | None) -> Iterator[str]:
    nominal, uniform, found = report.nominal, uniform_rate(report), attack_rate(report)
    if nominal is not None:
        plural = "" if nominal.evaluations == 1 else "s"
        often = percent(nominal.fooled / nominal.evaluations)
        yield f"{often} as it is (nominal, {nominal.evaluations} episode{plural})"
    if uniform is None:
        yield "unknown for all worlds in the ranges: --adversary random"
    else:
        text = rate_text(uniform, f"{uniform.samples:,} worlds")
        yield text.replace(" (", " of all worlds in the ranges (")
    if report.settings.experiment.adversary.name != "random":
        text = rate_text(found, f"{found.samples:,} new ones")
        yield text.replace(" (", f" of worlds that {report.settings.label} makes (")
    if failures is not None:
        yield failures.again


def _requirements(report: RunReport) -> Iterator[tuple[str, str]]:
    """Say which formula the score stands for; of several requirements, which failed together."""
    target, counts = report.settings.experiment.target, report.requirements
    score: Any = target.application.settings.get("score")
    if isinstance(score, list) and score[:1] == ["stl"]:
        yield "requirement", f"{_said(score)}, fails where Q ≤ {target.fooling_threshold:g}"
    named = score[-1] if isinstance(score, list) and score else score
    if counts is None or not isinstance(named, dict):
        return
    lines = [
        f"{name}: {_said(one)}, fails where Q ≤ {threshold:g}; broken in {counts.each[name]} of "
        f"{counts.worlds} failures"
        for name, (one, threshold) in named.items()
    ]
    together = [f"{names} in {count}" for names, count in counts.together.items()]
    yield "requirements", "\n".join([*lines, f"together: {', '.join(together)}"])


def _said(score: Any) -> str:
    if not isinstance(score, list):
        return str(score)
    said = score[1:2] if score[0] == "stl" else score
    return " ".join(" ".join(map(str, said)).split())  # a formula may have several lines


def _in_use(found: FailureProbability) -> str:
    low, high = found.interval_95
    text = f"fails with probability {tenths(found.probability)} (95 % interval {100 * low:.1f} "
    text += f"to {100 * high:.1f}), by {found.worlds:,} uniform worlds worth {found.worth:.0f}"
    if found.held < _ALL_HELD:
        text += f"; the ranges hold {tenths(found.held)} of such worlds"
    if found.worth < _FEW_DRAWS:
        text += ". That is little: use a larger budget, or narrow the ranges to what occurs"
    return text


def _feasible(found: FeasibleRate, fooled: int) -> str:
    if found.afr is None:
        return "unknown: the privileged agent fails in the worlds of all samples"
    text = f"{tenths(found.afr)}, {found.fooled} of {found.worlds} samples"
    if not fooled:
        return text
    return f"{text}; in {fooled - found.fooled} of {fooled} failures the privileged agent fails too"


def _invalid(invalid: InvalidWorlds, report: RunReport, values: _Values) -> str:
    samples = report.settings.experiment.protocol.samples
    counts = f"{invalid.queries:,} of {report.search.queries:,} queries"
    text = f"{counts}, {invalid.samples:,} of {samples:,} samples; no failures of the agent"
    if invalid.parameters is not None:
        world = values.world(invalid.parameters)
        text += f". The first: {world}, seed {invalid.seed}: {invalid.reason}"
    if invalid.infeasible:
        text += f". {invalid.infeasible:,} more queries were infeasible"
    return text


def _world(report: RunReport) -> str:
    """Name the keywords of a general id, and the track that has them."""
    target = report.settings.experiment.target
    card = find_card(target.application.name)
    if card is None or target.track.rpartition(":")[2] != card.id:
        return ""
    given = target.application.settings
    for suffix, keywords in card.tracks.items():
        if keywords and all(given.get(name) == value for name, value in keywords.items()):
            listed = ", ".join(f"{name}={value}" for name, value in keywords.items())
            return f" ({listed}, as in {card.track_id(suffix)})"
    return ""


def _influences(influences: tuple[Influence, ...], values: _Values) -> str:
    listed = [
        f"{values.label(one.parameter)} {'explains ' * (not place)}{100 * one.total:.0f} % "
        f"({100 * one.total_interval[0]:.0f} to {100 * one.total_interval[1]:.0f})"
        for place, one in enumerate(influences[:3])
    ]
    return ", ".join(listed)


def _nearest(nominal: NominalWorld, values: _Values) -> str:
    alone = [
        f"{values.label(change.parameter)} from "
        f"{values.alone(change.parameter, change.nominal)} to "
        f"{values.alone(change.parameter, change.value)}"
        for change in nominal.smallest[:_MOST_CHANGES]
    ]
    if alone:
        return f"{', or '.join(alone)}, and nothing else"
    if nominal.nearest is None:
        return "none known"
    return f"{values.world(nominal.nearest.parameters)}; no parameter alone does it"


def _combined(found: Combined, values: _Values) -> str:
    alone = [
        f"{values.text(name, low)} to {values.alone(name, high)}"
        for name, (low, high) in found.harmless.items()
    ]
    return (
        f"within amounts of which each alone is harmless, "
        f"{rate_text(Rate.of(found.fooled, found.worlds), f'{found.worlds} worlds')} fail, and "
        f"{found.within} of the {found.failures} failures lie there.\n"
        f"Harmless alone: {', '.join(alone)}"
    )


class _Values:
    """Writes physical values by the parameters' names; by their labels where these are known."""

    def __init__(self, space: ParameterSpace | None) -> None:
        self._known = (
            {} if space is None else {parameter.name: parameter for parameter in space.parameters}
        )

    def label(self, name: str) -> str:
        return self._known[name].label if name in self._known else name

    def text(self, name: str, value: float) -> str:
        known = self._known.get(name)
        return f"{name} {number(value)}" if known is None else known.text(value)

    def alone(self, name: str, value: float) -> str:
        return self.text(name, value).removeprefix(self.label(name)).strip()

    def world(self, values: Mapping[str, float]) -> str:
        return ", ".join(self.text(name, value) for name, value in values.items())
