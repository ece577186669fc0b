"""Statistics over runs: mean and interquartile mean, bootstrap intervals, shared ranks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.stats import norm, t, trim_mean

from sada_gym.errors import UserError
from sada_gym.foundations.arrays import Bools, Floats, as_array

Interval = tuple[float, float]
Statistic = Literal["mean", "iqm"]
Resampled = Literal["seeds", "test samples", "seeds and test samples", "nothing"]

_TRIMMED = {"mean": 0.0, "iqm": 0.25}  # cut off at either end


@dataclass(frozen=True)
class Estimate:
    """A statistic of many runs and its bootstrap interval, None where nothing could be resampled.

    With one seed a track the test samples are drawn again at best. The interval then does not show
    how another training run would have turned out.
    """

    value: float
    interval: Interval | None
    resampled: Resampled


@dataclass(frozen=True)
class Standing:
    """An adversary's figure, its interval where that is known, and its rank in a table.

    The best has rank 1, a control none. Tables show the label: `1`, `1=` where the rank is shared,
    `-` for a control.
    """

    name: str
    value: float
    interval: Interval | None
    rank: int | None
    label: str


def interquartile_mean(values: npt.ArrayLike) -> float:
    """Average the middle half of all values, of any shape (Agarwal et al., NeurIPS 2021).

    A quarter, rounded down, is cut off at either end; of three values or fewer it is the mean.

    Raises:
        ValueError: If there are none, or one is not finite.
    """
    flat = as_array(values, "values").astype(np.float64).ravel()
    if not len(flat) or not np.isfinite(flat).all():
        raise UserError(f"Expected at least one value and all of them finite, got {flat}.")
    return float(trim_mean(flat, _TRIMMED["iqm"]))


def estimate(
    values: npt.ArrayLike,
    *,
    statistic: Statistic = "mean",
    samples: int | npt.ArrayLike | None = None,
    draws: npt.ArrayLike | None = None,
    seed: int = 0,
    resamples: int = 10_000,
    level: float = 0.95,
) -> Estimate:
    """Estimate a statistic over tracks and seeds with its stratified bootstrap interval.

    The seeds are resampled within each track (Agarwal et al., NeurIPS 2021, section 4), with two
    corrections for few seeds. n - 1 of a track's n seeds are drawn, which makes the variance
    unbiased (McCarthy and Snowden 1985; Rao and Wu 1988). And the percentiles are those of
    Student's t with as many degrees of freedom as the seeds leave (the expanded percentile
    interval, Hesterberg 2015). Simulated at 95 % (studies/intervals.py), the interval holds the
    truth 94 to 96 % of the time for 3 seeds or more on each of 6 tracks or more, but on one track
    76 % for 3 seeds, 92 % for 5, 95 % for 10.

    Where a track has one seed, or seeds whose fooling rates differ no more than the M test samples
    alone would make them, the test samples are resampled instead: the track's rate is drawn from
    its Jeffreys posterior, the Beta(x + 1/2, N - x + 1/2) of x fooled among N samples of all seeds.

    Values are one figure for each run, (tracks, seeds); `level` is the interval's nominal coverage.
    `samples` is M where the values are rates among M test samples, as AFR is: one number, or one
    for each track; None where they are anything else, such as coverage. `draws` are for figures
    that are no plain rates: what each track's mean could have been with other test samples,
    (tracks, resamples). They stand in for the posterior of a rate. Raise `UserError` for arguments
    that are not as described.
    """
    runs = as_array(values, "values").astype(np.float64)
    _check(runs, statistic, resamples, level)
    seeds = runs.shape[1]
    value = float(trim_mean(runs.ravel(), _TRIMMED[statistic]))
    if samples is None and draws is None and seeds == 1:
        return Estimate(value, None, "nothing")
    counts = None if samples is None else _validate_counts(samples, runs)
    means = None if draws is None else _validate_draws(draws, (len(runs), resamples))
    tested = _varies_as_samples_do(runs, counts, means)
    drawn = _resample(runs, counts, means, tested, resamples, np.random.default_rng(seed))

    freedom = (seeds - 1) * int((~tested).sum())
    tail = (1.0 - level) / 2
    if freedom:
        tail = float(norm.cdf(t.ppf(tail, freedom)))
    replicates = trim_mean(drawn.reshape(resamples, -1), _TRIMMED[statistic], axis=1)
    low, high = np.quantile(replicates, [tail, 1.0 - tail])
    kinds: tuple[Resampled, ...] = ("seeds", "seeds and test samples", "test samples")
    kind = kinds[int(tested.any()) + int(tested.all())]
    return Estimate(value, (min(float(low), value), max(float(high), value)), kind)


def shared_ranks(
    values: Mapping[str, float],
    intervals: Mapping[str, Interval | None],
    *,
    controls: Collection[str] = (),
) -> tuple[Standing, ...]:
    """Rank adversaries so that those which the data cannot tell apart share a rank.

    An adversary's rank is 1 + the number of adversaries whose interval lies entirely above its
    own, but never better than that of an adversary with a higher value: a wide interval
    wins no rank. Shared ranks are not transitive: with A over B over C, where only the intervals
    of A and C are apart, A and B share rank 1 and C has rank 2. An unknown interval, None, overlaps
    with all others. Controls stand in the table without a rank and count for nobody's.

    Returns:
        The standings of all adversaries, the highest value first.

    Raises:
        ValueError: If the names differ, a value is not finite or an interval is upside down.
    """
    if values.keys() != intervals.keys():
        raise UserError(
            f"Expected an interval, or None, for each of {sorted(values)}, got some for "
            f"{sorted(intervals)}."
        )
    bounds = {name: interval or (-np.inf, np.inf) for name, interval in intervals.items()}
    for name, (low, high) in bounds.items():
        if not (np.isfinite(values[name]) and low <= high):
            raise UserError(
                f"Expected a finite value and low <= high for {name}, got {values[name]} and "
                f"({low}, {high})."
            )
    ranked = [name for name in values if name not in controls]
    above = {name: sum(bounds[o][0] > bounds[name][1] for o in ranked) for name in ranked}
    ranks = {
        name: 1 + max(above[o] for o in ranked if values[o] >= values[name]) for name in ranked
    }
    count = Counter(ranks.values())
    labels = {name: f"{rank}=" if count[rank] > 1 else str(rank) for name, rank in ranks.items()}
    return tuple(
        Standing(name, values[name], intervals[name], ranks.get(name), labels.get(name, "-"))
        for name in sorted(values, key=lambda name: -values[name])
    )


def _varies_as_samples_do(runs: Floats, counts: Floats | None, means: Floats | None) -> Bools:
    tracks, seeds = runs.shape
    spread = runs.var(axis=1, ddof=1) if seeds > 1 else np.zeros(tracks)
    if means is not None:
        return np.asarray(spread <= seeds * means.var(axis=1))
    if counts is None:
        return np.zeros(tracks, np.bool_)
    rate = runs.mean(axis=1)
    return np.asarray(spread <= rate * (1.0 - rate) / counts)


def _resample(
    runs: Floats,
    counts: Floats | None,
    means: Floats | None,
    tested: Bools,
    resamples: int,
    rng: np.random.Generator,
) -> Floats:
    tracks, seeds = runs.shape
    chosen = rng.integers(seeds, size=(resamples, tracks, max(seeds - 1, 1)))
    drawn = np.take_along_axis(runs[None], chosen, axis=2)
    if means is not None:
        drawn[:, tested] = means[tested].T[:, :, None]
    elif counts is not None:
        fooled, trials = np.round(runs.sum(axis=1) * counts)[tested], (counts * seeds)[tested]
        rates = rng.beta(fooled + 0.5, trials - fooled + 0.5, size=(resamples, len(fooled)))
        drawn[:, tested] = rates[:, :, None]
    return drawn


def _check(runs: Floats, statistic: str, resamples: int, level: float) -> None:
    if runs.ndim != 2 or not runs.size or not np.isfinite(runs).all():
        raise UserError(
            f"Expected finite values of shape (tracks, seeds), got shape {runs.shape}: {runs}. "
            "Every track needs the same number of seeds."
        )
    if statistic not in get_args(Statistic):
        raise UserError(f"Expected the statistic to be mean or iqm, got {statistic!r}.")
    if resamples < 1 or not 0.0 < level < 1.0:
        raise UserError(
            "Expected at least 1 resample and a level within (0, 1), got "
            f"resamples={resamples}, level={level}."
        )


def _validate_draws(draws: npt.ArrayLike, shape: tuple[int, int]) -> Floats:
    means = as_array(draws, "draws").astype(np.float64)
    if means.shape != shape or not np.isfinite(means).all():
        raise UserError(
            f"Expected finite draws of shape (tracks, resamples) = {shape}, got shape "
            f"{means.shape}. Give one row of draws for each track."
        )
    return means


def _validate_counts(samples: int | npt.ArrayLike, runs: Floats) -> Floats:
    given = as_array(samples, "samples").astype(np.float64)
    if given.shape not in {(), (len(runs),)} or not (given >= 1).all():
        raise UserError(
            f"Expected samples to be a number of at least 1, or {len(runs)} of them, one for each "
            f"track; got {samples!r}."
        )
    counts = np.broadcast_to(given, len(runs))
    fooled = runs * counts[:, None]
    if (np.abs(fooled - np.round(fooled)) > 1e-6).any() or (runs < 0).any() or (runs > 1).any():
        raise UserError(
            f"Expected rates among {counts} samples, got {runs}, which are not. Leave samples out "
            "for a figure that is no rate."
        )
    return counts
