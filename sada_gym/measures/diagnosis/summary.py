"""A diagnosis in lines for people."""

from __future__ import annotations

from collections.abc import Iterator

from sada_gym.foundations.figures import number, percent
from sada_gym.measures.diagnosis.record import Diagnosis, Weakness
from sada_gym.measures.rates import Rate


def rows(diagnosis: Diagnosis) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each weakness, or one row that says why there is none."""
    if not diagnosis.weaknesses:
        yield "where", diagnosis.sentence
    for place, weakness in enumerate(diagnosis.weaknesses, 1):
        name = "weakness" if len(diagnosis.weaknesses) == 1 else f"weakness {place}"
        text = f"{weakness.text}: {_findings(weakness)}"
        yield name, text if weakness.behaviour is None else f"{text}; {weakness.behaviour}"


def details(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield lines that say all of a diagnosis but its examples."""
    yield diagnosis.sentence
    for place, weakness in enumerate(diagnosis.weaknesses, 1):
        yield f"{place}. {weakness.text}"
        yield f"   {_findings(weakness)}"
        apart = f" in {weakness.distinct} groups that lie apart" if weakness.distinct > 1 else ""
        yield (
            f"   {percent(weakness.volume)} of all worlds; {weakness.failures:,} known "
            f"failures{apart}"
        )
        if weakness.behaviour is not None:
            yield f"   {weakness.behaviour}"
        if weakness.confirmed is not None:
            yield f"   {rate_text(weakness.confirmed)} failed again on fresh seeds"
        for end in weakness.thresholds:
            low, high = end.interval_95
            interval = f"{number(low)} to {number(high)}"
            yield f"   {end.parameter}: threshold {number(end.value)} (95 % interval {interval})"
    if diagnosis.weaknesses:
        yield (
            f"  {percent(diagnosis.explained)} of the failures lie in a weakness. By "
            f"{diagnosis.worlds:,} worlds of the run and {diagnosis.fresh:,} fresh ones."
        )


def rate_text(rate: Rate) -> str:
    """Write a rate with its interval: `81 % (63 to 92)`."""
    low, high = rate.interval_95
    return f"{percent(rate.rate)} ({100 * low:.0f} to {100 * high:.0f})"


def _findings(weakness: Weakness) -> str:
    share = f"{percent(weakness.share)} of the failures"
    if not weakness.is_checked:
        share += "; not yet confirmed, too few fresh worlds say so clearly"
    if weakness.inside is None:
        return share
    elsewhere = "" if weakness.outside is None else f", {rate_text(weakness.outside)} elsewhere"
    return f"{rate_text(weakness.inside)} fooled{elsewhere}; {share}"
