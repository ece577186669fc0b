"""Figures over runs: means over tracks with unequal numbers of seeds, their intervals and ranks."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import t

from sada_gym.foundations.files import Strict
from sada_gym.measures.statistics import Interval, estimate, shared_ranks

Runs = Sequence[Sequence[float]]
"""One figure for each run, by track and then by seed."""

Draws = npt.NDArray[np.float64]
"""What each track's mean could have been with other test samples, (tracks, resamples)."""


class Figure(Strict):
    """A figure of an adversary.

    Attributes:
        value: The mean over seeds, then over tracks.
        interval_95: The mean's interval; None where single runs give none.
    """

    value: float
    interval_95: Interval | None


def figure(
    runs: Runs, samples: Sequence[int] | None = None, draws: Draws | None = None
) -> Figure | None:
    """Average runs over seeds, then over tracks, with a 95 % interval.

    Where all tracks have as many seeds it is the bootstrap of
    `sada_gym.measures.statistics.estimate`. Otherwise figures with `samples` or `draws` are
    estimated so for each number of seeds and the intervals put together as those of a weighted sum
    of independent estimates (Zou and Donner 2008: the distances from the estimate add up in
    squares). Other figures get Student's interval, the variance between the seeds of a track pooled
    over the tracks that have several.

    Args:
        runs: One figure for each run.
        samples: M of each track, where the figures are rates among M test samples.
        draws: What each track's mean could have been with other test samples, for figures that
            are no plain rates.

    Returns:
        The figure; None without runs.
    """
    if not runs:
        return None
    counts = {len(seeds) for seeds in runs}
    if len(counts) > 1 and samples is None and draws is None:
        return _pooled(runs)
    value = float(np.mean([np.mean(seeds) for seeds in runs]))
    below = above = 0.0
    for count in counts:
        rows = [i for i, seeds in enumerate(runs) if len(seeds) == count]
        part = estimate(
            [runs[i] for i in rows],
            samples=None if samples is None else [samples[i] for i in rows],
            draws=None if draws is None else draws[rows],
        )
        if len(counts) == 1:
            return Figure(value=part.value, interval_95=part.interval)
        assert part.interval is not None
        weight = len(rows) / len(runs)
        below += (weight * (part.value - part.interval[0])) ** 2
        above += (weight * (part.interval[1] - part.value)) ** 2
    return Figure(value=value, interval_95=(value - math.sqrt(below), value + math.sqrt(above)))


def ranks_of(figures: Mapping[str, Figure], unranked: Collection[str]) -> dict[str, str]:
    """Rank figures, higher being better; those whose difference is in doubt share a rank.

    Args:
        figures: The figures by name.
        unranked: Names that get no rank and count for nobody's.

    Returns:
        The ranks, `1` or shared `1=`, of those that have one; none where no figure has an interval.
    """
    intervals = {name: figure.interval_95 for name, figure in figures.items()}
    if not any(intervals.values()):
        return {}
    values = {name: figure.value for name, figure in figures.items()}
    standings = shared_ranks(values, intervals, controls=unranked)
    return {standing.name: standing.label for standing in standings if standing.rank}


def _pooled(runs: Runs) -> Figure:
    value = float(np.mean([np.mean(seeds) for seeds in runs]))
    freedom = sum(len(seeds) - 1 for seeds in runs)
    variance = sum(float(np.var(seeds)) * len(seeds) for seeds in runs) / freedom
    error = math.sqrt(variance * sum(1 / len(seeds) for seeds in runs)) / len(runs)
    margin = float(t.ppf(0.975, freedom)) * error
    return Figure(value=value, interval_95=(value - margin, value + margin))
