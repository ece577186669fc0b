"""Two runs beside each other: the worlds that both evaluated, and the settings that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sada_gym.analyses.report.views import RunView
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.figures import number, percent
from sada_gym.measures.rates import FoolingRate, Rate, lead_interval


def compare(first: RunView, second: RunView) -> str:
    """Say in a sentence which of two runs, A and B, fails more often, by how much, and how sure.

    Where both evaluated worlds of the same mu and seed, these are compared; worlds of different
    parameters or ranges are different worlds. Else it is the rates of the adversaries' worlds.
    """
    pairs: list[tuple[bool, bool]] = []
    if first.columns.parameters == second.columns.parameters:
        ours, theirs = (_verdicts(run) for run in (first, second))
        pairs = [(ours[key], theirs[key]) for key in ours.keys() & theirs.keys()]
    if pairs:
        rates = [Rate.of(sum(fails), len(pairs)) for fails in zip(*pairs, strict=True)]
        low, high = _paired_interval(pairs)
        where = f"of the {len(pairs):,} worlds that both runs evaluated"
        more = "fails more often", "both fail about equally often as far as these worlds tell"
    else:
        rates = [first.afr.rate, second.afr.rate]
        low, high = lead_interval(*map(_fooling_rate, rates))
        where = "of the worlds that its adversary makes"
        more = "is attacked more successfully", "neither attack is clearly stronger"
    one, other = (percent(rate.rate) for rate in rates)
    points = 100 * (rates[0].rate - rates[1].rate)
    letter = "A" if low > 0 else "B"
    verdict = f"{letter} {more[0]}" if low > 0 or high < 0 else more[1]
    return (
        f"A fails in {one} {where}, B in {other}: a difference of {number(abs(points))} points "
        f"(95 % interval of A less B {number(100 * low)} to {number(100 * high)}), so {verdict}."
    )


def _paired_interval(pairs: Sequence[tuple[bool, bool]]) -> tuple[float, float]:
    """Return the 95 % interval of a difference of paired rates (Bonett and Price 2012)."""
    count = len(pairs) + 2
    first, second = ((pairs.count(one) + 1) / count for one in ((True, False), (False, True)))
    lead = first - second
    margin = 1.96 * ((first + second - lead**2) / count) ** 0.5
    return max(-1.0, lead - margin), min(1.0, lead + margin)


def _fooling_rate(rate: Rate) -> FoolingRate:
    return FoolingRate(rate.fooled, rate.samples, rate.rate, *rate.interval_95)


def _verdicts(run: RunView) -> dict[tuple[bytes, int], bool]:
    worlds = Evaluations.joined([run.samples, run.queries]).valid
    fooled = worlds.fooled(run.target.fooling_threshold).tolist()
    mu = np.ascontiguousarray(worlds.mu + np.float32(0.0))  # -0 is 0
    keys = zip((row.tobytes() for row in mu), worlds.seed.tolist(), strict=True)
    return dict(zip(keys, fooled, strict=True))


def different_settings(first: RunView, second: RunView) -> list[tuple[str, str, str]]:
    """List the settings in which two runs differ, with both values."""
    ours, theirs = (_flat(run.settings.model_dump(mode="json")) for run in (first, second))
    return [
        (name, ours.get(name, "-"), theirs.get(name, "-"))
        for name in dict.fromkeys([*ours, *theirs])
        if ours.get(name) != theirs.get(name)
    ]


def _flat(record: Mapping[str, Any], start: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for name, value in record.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{start}{name}.")
        else:
            flat[f"{start}{name}"] = str(value)
    return flat
