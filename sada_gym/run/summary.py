"""The summary of an attack for people: how often the agent failed, where, and by which files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from sada_gym.experiment.invalid import InvalidWorlds
from sada_gym.experiment.measure import FeasibleRate
from sada_gym.experiment.nominal import Combined, NominalWorld
from sada_gym.experiment.record import FailureProbability, RunReport
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.figures import number, percent, tenths
from sada_gym.measures.likelihood import FailureEstimate
from sada_gym.measures.rates import wilson_interval
from sada_gym.measures.sensitivity import Influence
from sada_gym.parameters import ParameterSpace
from sada_gym.run.folder import RESULT_FILE

AFR = "attack fooling rate"

_ALL_HELD = 0.995
_FEW_DRAWS = 30


def title(report: RunReport) -> str:
    """Name a run: what was attacked, and by which adversary."""
    return f"{report.settings.experiment.target.track} · {report.settings.label}"


def summary_rows(
    report: RunReport,
    further: Iterable[tuple[str, str]] = (),
    *,
    where: Iterable[tuple[str, str]] = (),
    space: ParameterSpace | None = None,
    likely: FailureEstimate | None = None,
) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each finding; `further` ones stand behind where it fails.

    The rows of a diagnosis say `where`, and an estimate how `likely` a failure is. With the
    parameters' `space` values are written as people say them: by labels, units and choices.
    """
    values = _Values(space)
    if (world := _world(report)) is not None:
        yield "environment", world
    low, high = report.afr_interval_95
    interval = f"95 % interval {100 * low:.1f} to {100 * high:.1f}"
    samples, invalid = report.settings.experiment.protocol.samples, report.invalid
    of_samples = f"{report.fooled} of {samples:,} samples"
    if invalid is not None and invalid.samples:
        of_samples = f"{report.fooled} of {samples - invalid.samples:,} samples in valid worlds"
    yield AFR, f"{tenths(report.afr)} ({interval}), {of_samples}"
    if report.nominal is not None and report.nominal.combined is not None:
        yield "combinations", _combined(report.nominal.combined)
        yield "harmless alone", _harmless(report.nominal, values)
    yield from where
    yield from further
    if report.influences:
        yield "what matters", _influences(report.influences, values)
    yield "uniform worlds", _uniform_rate(report)
    if likely is not None:
        yield from likely.rows()
    elif report.in_use is not None:
        yield "in ordinary use", _in_use(report.in_use)
    if report.nominal is not None:
        yield "nominal world", _nominal(report.nominal, values)
        if not report.nominal.fooled * 2 > report.nominal.evaluations:
            yield "smallest change", _smallest(report.nominal, values)
    if report.feasible is not None:
        yield "over feasible worlds", _feasible(report.feasible, report.fooled)
    if report.search.fooling_rate is not None:
        rate = tenths(report.search.fooling_rate)
        yield "in training", f"{rate} of {report.search.queries:,} queries fooled the agent"
    if invalid is not None:
        yield "invalid worlds", _invalid(invalid, report, values)
    yield "spread (mu_std)", f"{report.mu_std:.3f}; uniform would be 0.577"
    if report.relative_coverage is not None:
        yield "coverage", f"{tenths(report.relative_coverage)}; ideal samples would be 100 %"
    if report.novelty is not None:
        yield "novelty", f"median distance {report.novelty.median:.3f} to the nearest query"
    for flag in report.flags:
        yield "warning", flag


def results_line(folder: Path, pictures: Iterable[Path]) -> str:
    """Say where the results lie."""
    files = [RESULT_FILE, *(path.name for path in pictures)]
    return f"Results: {folder}/ ({', '.join(files)})"


def _in_use(found: FailureProbability) -> str:
    low, high = found.interval_95
    text = f"fails with probability {tenths(found.probability)} (95 % interval {100 * low:.1f} "
    text += f"to {100 * high:.1f}), by {found.worlds:,} uniform worlds worth {found.worth:.0f}"
    if found.held < _ALL_HELD:
        text += f"; the ranges hold {tenths(found.held)} of such worlds"
    if found.worth < _FEW_DRAWS:
        text += ". That is little: ask more, or shrink the ranges to what occurs"
    return text


def _feasible(found: FeasibleRate, fooled: int) -> str:
    if found.afr is None:
        return "not known: the privileged agent fails in all of the samples' worlds"
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


def _world(report: RunReport) -> str | None:
    target = report.settings.experiment.target
    card = find_card(target.application.name)
    if card is None or target.track.rpartition(":")[2] != card.id:
        return None
    given = target.application.settings
    for suffix, keywords in card.tracks.items():
        if keywords and all(given.get(name) == value for name, value in keywords.items()):
            listed = ", ".join(f"{name}={value}" for name, value in keywords.items())
            return f"{listed}, as in {card.track_id(suffix)}"
    return None


def _uniform_rate(report: RunReport) -> str:
    experiment = report.settings.experiment
    adversary, reference = experiment.adversary.name, experiment.target.reference
    if reference is not None:
        return f"{tenths(reference.uniform_rate)} (reference set of {reference.points:,} points)"
    if adversary == "random":
        return f"{tenths(report.afr)} (these samples are uniform)"
    uniform = report.uniform
    if uniform is None:
        return "not known: run --adversary random"
    which = "its" if uniform.worlds == report.search.queries else "the first"
    rate = tenths(uniform.fooled / uniform.worlds)
    return f"{rate} ({which} {uniform.worlds:,} training queries are uniform)"


def _influences(influences: tuple[Influence, ...], values: _Values) -> str:
    listed = [
        f"{values.label(influence.parameter)} {100 * influence.total:.0f} % "
        f"({100 * influence.total_interval[0]:.0f} to {100 * influence.total_interval[1]:.0f})"
        for influence in influences[:3]
    ]
    return f"{', '.join(listed)}: the share of the failures' variance that each takes part in"


def _nominal(nominal: NominalWorld, values: _Values) -> str:
    often = f"fooled {nominal.fooled} of {nominal.evaluations} times"
    text = f"mean score {nominal.score:.2f}, {often} ({values.world(nominal.parameters)})"
    if nominal.played is None:
        return text
    return f"{text}; {nominal.played:,} evaluations beside the budget were spent around it"


def _smallest(nominal: NominalWorld, values: _Values) -> str:
    alone = [
        f"{values.text(change.parameter, change.nominal)} to "
        f"{values.alone(change.parameter, change.value)}"
        for change in nominal.smallest
    ]
    text = f"that alone makes it fail: {', or '.join(alone)}" if alone else "none alone does"
    if nominal.nearest is None:
        return text
    return f"{text}; nearest failure of all worlds: {values.world(nominal.nearest.parameters)}"


def _combined(found: Combined) -> str:
    low, high = wilson_interval(found.fooled, found.worlds)
    rate = f"{percent(found.fooled / found.worlds)} ({100 * low:.0f} to {100 * high:.0f})"
    return (
        f"within amounts of which each alone is harmless, {rate} of {found.worlds} uniform worlds "
        f"fool, and {found.within} of the {found.failures} failures lie there"
    )


def _harmless(nominal: NominalWorld, values: _Values) -> str:
    assert nominal.combined is not None
    listed = [
        f"{values.text(name, low)} to {values.alone(name, high)}"
        for name, (low, high) in nominal.combined.harmless.items()
    ]
    return ", ".join(listed)


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
