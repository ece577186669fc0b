"""A diagnosis in lines for people."""

from __future__ import annotations

from collections.abc import Iterator

from sada_gym.foundations.figures import number, percent
from sada_gym.measures.diagnosis.record import Diagnosis, Weakness
from sada_gym.measures.rates import Rate


def weakness_lines(diagnosis: Diagnosis, *, details: bool = False) -> Iterator[str]:
    """Yield a line for each weakness, and its figures below; without any, why there is none."""
    if not diagnosis.weaknesses:
        yield diagnosis.sentence
    for place, weakness in enumerate(diagnosis.weaknesses, 1):
        yield f"{place}. {weakness.text}"
        for line in figures(weakness):
            yield f"   {line}"
        if not details:
            continue
        apart = f" in {weakness.distinct} separate regions" if weakness.distinct > 1 else ""
        yield (
            f"   {percent(weakness.volume)} of all worlds; {weakness.failures:,} known "
            f"failures{apart}"
        )
        if weakness.confirmed is not None:
            again = f"{weakness.confirmed.fooled} of {weakness.confirmed.samples}"
            yield f"   {again} tried fail again on fresh seeds"
        for end in weakness.thresholds:
            low, high = end.interval_95
            interval = f"{number(low)} to {number(high)}"
            yield f"   {end.parameter}: threshold {number(end.value)} (95 % interval {interval})"


def figures(weakness: Weakness) -> Iterator[str]:
    """Yield how often the agent fails in a weakness and elsewhere, and what it does there."""
    if weakness.inside is not None:
        outside = "" if weakness.outside is None else f", {rate_text(weakness.outside)} elsewhere"
        yield f"{rate_text(weakness.inside)} fail{outside}"
    behaviour = "" if weakness.behaviour is None else f"; {weakness.behaviour}"
    yield f"{percent(weakness.share)} of all failures{behaviour}"
    if not weakness.is_checked:
        yield "not yet confirmed: too few fresh worlds to be sure"


def details(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield lines that say all of a diagnosis but its examples."""
    if diagnosis.weaknesses:
        yield diagnosis.sentence
    yield from weakness_lines(diagnosis, details=True)
    if diagnosis.weaknesses:
        yield (
            f"  {percent(diagnosis.explained)} of the failures lie in a weakness. Based on "
            f"{diagnosis.worlds:,} worlds of the run and {diagnosis.fresh:,} fresh ones."
        )


def rate_text(rate: Rate, note: str = "") -> str:
    """Write a rate with its interval: `81 % (63 to 92)`, and maybe of what: `(63 to 92, note)`."""
    low, high = rate.interval_95
    more = f", {note}" if note else ""
    return f"{percent(rate.rate)} ({100 * low:.0f} to {100 * high:.0f}{more})"
