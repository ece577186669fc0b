"""Figures over runs: means over tracks with unequal numbers of seeds, and their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import t

from sada_gym.files import Strict
from sada_gym.measures.statistics import Interval, estimate, shared_ranks

Runs = Sequence[Sequence[float]]
"""One figure for each run, by track and then by seed."""


class Figure(Strict):
    """A figure of a contender.

    Attributes:
        value: The mean over seeds, then over tracks.
        interval_95: The mean's interval; None where single runs give none.
        rank: `1`, or shared `1=`; None for controls, for what is incomplete, and without intervals.
    """

    value: float
    interval_95: Interval | None
    rank: str | None = None


def figure(runs: Runs, samples: Sequence[int] | None = None) -> Figure | None:
    """Average runs over seeds, then over tracks, with a 95 % interval.

    Where all tracks have as many seeds it is the bootstrap of
    `sada_gym.measures.statistics.estimate`. Otherwise rates are estimated so for each number of
    seeds and the intervals put together as those of a weighted sum of independent estimates (Zou
    and Donner 2008: the distances from the estimate add up in squares). Other figures get Student's
    interval, the variance between the seeds of a track pooled over the tracks that have several.

    Args:
        runs: One figure for each run.
        samples: M of each track, where the figures are rates among M test samples.

    Returns:
        The figure; None without runs.
    """
    if not runs:
        return None
    if len({len(seeds) for seeds in runs}) == 1:
        plain = estimate(runs, samples=None if samples is None else list(samples))
        return Figure(value=plain.value, interval_95=plain.interval)
    value = float(np.mean([np.mean(seeds) for seeds in runs]))
    interval = _pooled(value, runs) if samples is None else _put_together(value, runs, samples)
    return Figure(value=value, interval_95=interval)


def ranked(figures: Mapping[str, Figure], unranked: Sequence[str]) -> dict[str, Figure]:
    """Rank figures, higher being better; those whose difference is in doubt share a rank."""
    intervals = {name: one.interval_95 for name, one in figures.items()}
    if not any(intervals.values()):
        return dict(figures)
    values = {name: one.value for name, one in figures.items()}
    standings = shared_ranks(values, intervals, controls=unranked)
    ranks = {one.name: one.label if one.rank else None for one in standings}
    return {name: one.model_copy(update={"rank": ranks[name]}) for name, one in figures.items()}


def _put_together(value: float, runs: Runs, samples: Sequence[int]) -> Interval:
    below = above = 0.0
    for count in {len(seeds) for seeds in runs}:
        rows = [i for i, seeds in enumerate(runs) if len(seeds) == count]
        part = estimate([runs[i] for i in rows], samples=[samples[i] for i in rows])
        assert part.interval is not None
        weight = len(rows) / len(runs)
        below += (weight * (part.value - part.interval[0])) ** 2
        above += (weight * (part.interval[1] - part.value)) ** 2
    return value - math.sqrt(below), value + math.sqrt(above)


def _pooled(value: float, runs: Runs) -> Interval:
    freedom = sum(len(seeds) - 1 for seeds in runs)
    variance = sum(float(np.var(seeds)) * len(seeds) for seeds in runs) / freedom
    error = math.sqrt(variance * sum(1 / len(seeds) for seeds in runs)) / len(runs)
    margin = float(t.ppf(0.975, freedom)) * error
    return value - margin, value + margin
