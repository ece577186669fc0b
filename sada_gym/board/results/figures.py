"""Figures over runs: means over tracks with unequal numbers of seeds, F1, intervals and ranks."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import t

from sada_gym.experiment.measure import Measures
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.files import Strict
from sada_gym.measures.statistics import Interval, estimate, shared_ranks

Runs = Sequence[Sequence[float]]
"""One figure for each run, by track and then by seed."""

Draws = Floats
"""What each track's mean could have been with other test samples, (tracks, resamples)."""

_RESAMPLES = 10_000


class Figure(Strict):
    """A mean of an adversary, with its interval.

    Attributes:
        value: The mean over seeds, then over tracks.
        interval_95: The 95 % interval of the mean; None if single runs give none.
    """

    value: float
    interval_95: Interval | None


def figure(
    runs: Runs, samples: Sequence[int] | None = None, draws: Draws | None = None
) -> Figure | None:
    """Average runs over seeds, then over tracks, with a 95 % interval.

    If all tracks have the same number of seeds, the interval is the bootstrap of
    `sada_gym.measures.statistics.estimate`. Otherwise, with `samples` or `draws`, each group of
    tracks with one number of seeds gets such an interval, and these are combined as for a weighted
    sum of independent estimates (Zou and Donner 2008: squared distances from the estimate add up).
    Without `samples` and `draws` it is Student's interval; the variance between the seeds of a
    track is pooled over tracks with several seeds.

    Args:
        runs: One figure for each run, by track and then by seed.
        samples: M of each track, if the figures are rates among M test samples.
        draws: (tracks, resamples), the means of each track with redrawn test samples, for figures
            that are not plain rates.

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
    """Rank figures; higher is better. Those whose order is in doubt share a rank.

    Args:
        figures: The figures by name.
        unranked: Names that get no rank and do not affect the ranks of others.

    Returns:
        The ranks by name, `1` or shared `1=`. It is empty if no figure has an interval.
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


def f1(afr: npt.ArrayLike, relative_coverage: npt.ArrayLike, ideal_afr: float = 1.0) -> Floats:
    """Return F1, the harmonic mean of the AFR and the relative coverage of samples.

    The AFR divided by that of ideal samples (at most 1) takes the role of precision, and relative
    coverage that of recall, as for generative models (Sajjadi et al. 2018, Kynkäänniemi et al.
    2019). An adversary that is bad at either has a low F1.

    Args:
        afr: Attack fooling rates, of any shape.
        relative_coverage: Coverages divided by that of ideal samples, of the same shape.
        ideal_afr: The AFR of ideal samples on the track.

    Returns:
        F1, of the same shape; 0 if both are 0.
    """
    precision = np.minimum(np.asarray(afr, np.float64) / ideal_afr, 1.0)
    recall = np.asarray(relative_coverage, np.float64)
    total = precision + recall
    joined = 2 * precision * recall / np.where(total > 0, total, 1.0)
    return np.asarray(joined, np.float64)


def f1_figure(
    runs: Mapping[str, Sequence[Measures]],
    samples: Mapping[str, int],
    ideal_afr: Mapping[str, float],
) -> Figure | None:
    """Average F1 over seeds, then over tracks, with a 95 % interval.

    The interval is the bootstrap over seeds. If a track has one seed, or its seeds differ no more
    than by chance in the test samples, the test samples are redrawn instead: the AFR from its
    Jeffreys posterior, and the coverage from that of a share among as many points as samples fool.

    Args:
        runs: The measures of the runs of each track, all with relative coverage.
        samples: M of each track.
        ideal_afr: The AFR of ideal samples by track; 1 if it is not known.
    """
    values, draws = [], []
    rng = np.random.default_rng(0)
    for track, seeds in runs.items():
        ideal = ideal_afr.get(track) or 1.0
        measured = [(measures.afr, measures.relative_coverage) for measures in seeds]
        values.append([float(f1(afr, covered or 0.0, ideal)) for afr, covered in measured])
        draws.append(_redrawn(seeds, samples[track], ideal, rng))
    return figure(values, draws=np.array(draws)) if values else None


def _redrawn(
    seeds: Sequence[Measures], samples: int, ideal: float, rng: np.random.Generator
) -> Draws:
    """Draw what the mean F1 of a track could have been with other test samples, (resamples,)."""
    total = np.zeros(_RESAMPLES)
    for measures in seeds:
        fooled, coverage = measures.fooled, measures.coverage or 0.0
        of_ideal = coverage / measures.relative_coverage if measures.relative_coverage else 1.0
        rates = rng.beta(fooled + 0.5, samples - fooled + 0.5, _RESAMPLES)
        covered = rng.beta(coverage * fooled + 0.5, (1.0 - coverage) * fooled + 0.5, _RESAMPLES)
        total += f1(rates, covered / of_ideal, ideal)
    return total / len(seeds)
