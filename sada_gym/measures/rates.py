"""How good a set of attack samples is: fooling rate, spread, distance to what is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.errors import UserError
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats, Indices, as_array
from sada_gym.foundations.files import Strict

_Z95 = 1.959963984540054  # the standard normal's 97.5 % point


@dataclass(frozen=True)
class FoolingRate:
    """The attack fooling rate (AFR): the share of samples with Q <= epsilon, its 95 % interval."""

    fooled: int
    samples: int
    rate: float
    low: float
    high: float

    def __str__(self) -> str:
        """Write it as people read it: `74.4 % (68.6 to 79.4)`."""
        return f"{self.rate:.1%} ({100 * self.low:.1f} to {100 * self.high:.1f})".replace("%", " %")


class Rate(Strict):
    """How many of some samples fool, with the 95 % interval of the share (Wilson)."""

    fooled: int
    samples: int
    rate: float
    interval_95: tuple[float, float]

    @classmethod
    def of(cls, fooled: int, samples: int) -> Self:
        """Measure a share of at least one sample."""
        interval = wilson_interval(fooled, samples)
        return cls(fooled=fooled, samples=samples, rate=fooled / samples, interval_95=interval)

    def __str__(self) -> str:
        """Write it as people read it: `74.4 % (68.6 to 79.4)`."""
        return str(FoolingRate(self.fooled, self.samples, self.rate, *self.interval_95))


def attack_fooling_rate(scores: npt.ArrayLike, threshold: float) -> FoolingRate:
    """Measure the AFR of scores Q, (n,), at a threshold, with its 95 % Wilson score interval.

    Raises:
        ValueError: If there are no scores, or a NaN among them.
    """
    q = as_array(scores, "scores").astype(np.float64)
    if q.ndim != 1 or not len(q) or np.isnan(q).any():
        raise UserError(f"Expected scores of shape (n,), n >= 1, without NaN; got {q!r}.")
    fooled = int(fools(q, threshold).sum())
    low, high = wilson_interval(fooled, len(q))
    return FoolingRate(fooled, len(q), fooled / len(q), low, high)


@dataclass(frozen=True)
class WeightedRate:
    """A rate of failures by importance weights, its 95 % interval, and how many draws it is worth.

    It is worth fewer draws than there are worlds, because few of these weigh much.
    """

    rate: float
    low: float
    high: float
    worth: float


def weighted_rate(
    fooled: npt.ArrayLike, log_weights: npt.ArrayLike, *, trust: float = 1.0
) -> WeightedRate | None:
    """Estimate how often the agent fails under a density, from worlds drawn by another one.

    The weights are those of self-normalised importance sampling. The interval is Wilson's for as
    many trials as the worlds are worth: Kish's effective number (1965), or less where the variance
    of the estimate (Owen 2013, section 9.2) says so.

    Args:
        fooled: Whether each of n worlds fooled the agent, (n,).
        log_weights: The logarithms of density over density, (n,), up to a constant; maybe -inf.
        trust: How much a world counts in the interval, at most 1: less where the rate is of a
            region that was chosen by these worlds.

    Returns:
        The rate; None where no world has a weight.
    """
    failed, logs = np.asarray(fooled, np.float64), np.asarray(log_weights, np.float64)
    if not len(logs) or logs.max() == -np.inf:
        return None
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    rate, worth = float(np.clip(weights @ failed, 0.0, 1.0)), float(1.0 / (weights**2).sum())
    variance = float((weights**2) @ (failed - rate) ** 2)
    if variance > 0.0:
        worth = min(worth, rate * (1.0 - rate) / variance)
    worth *= trust
    low, high = _wilson(rate, max(worth, 1.0))
    return WeightedRate(rate, low, high, worth)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927).

    Unlike the normal approximation it stays within [0, 1] and has a width at 0 and 1 as well.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise UserError(
            f"Expected 0 <= successes <= trials, trials >= 1; got {successes} of {trials}."
        )
    return _wilson(successes / trials, trials)


def _wilson(rate: float, trials: float) -> tuple[float, float]:
    shrink = _Z95**2 / trials
    centre = rate + shrink / 2
    margin = _Z95 * math.sqrt(rate * (1 - rate) / trials + shrink / (4 * trials))
    low = 0.0 if rate == 0.0 else (centre - margin) / (1 + shrink)
    high = 1.0 if rate == 1.0 else (centre + margin) / (1 + shrink)
    return low, high


def lead_interval(ours: FoolingRate, theirs: FoolingRate) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two independent rates, ours minus theirs.

    Newcombe 1998, method 10: built from the two Wilson intervals.
    """
    lead = ours.rate - theirs.rate
    below = math.hypot(ours.rate - ours.low, theirs.high - theirs.rate)
    above = math.hypot(ours.high - ours.rate, theirs.rate - theirs.low)
    return lead - below, lead + above


def mu_std(mu: npt.ArrayLike) -> float:
    """Measure the spread of samples (n, d), n >= 1: their standard deviation, mean over dimensions.

    The paper's mu_std; 0.577 for uniform samples, 0 where all are one point.
    """
    samples = as_array(mu, "mu").astype(np.float64)
    if samples.ndim != 2 or not len(samples):
        raise UserError(f"Expected mu of shape (n, d), n >= 1, got {samples.shape}.")
    return float(samples.std(axis=0).mean())


def nearest_neighbours(samples: npt.ArrayLike, queries: npt.ArrayLike) -> tuple[Floats, Indices]:
    """Find the nearest training query, of (m, d), m >= 1, of each sample of (n, d).

    Distances, (n,), are Euclidean, near 0 if an adversary memorises; with them come the rows.
    """
    from scipy.spatial import cKDTree

    points = as_array(samples, "samples").astype(np.float64)
    tree = as_array(queries, "queries").astype(np.float64)
    if points.ndim != 2 or tree.ndim != 2 or points.shape[1] != tree.shape[1] or not len(tree):
        raise UserError(
            "Expected samples of shape (n, d) and queries of shape (m, d), m >= 1, got "
            f"{points.shape} and {tree.shape}."
        )
    distances, indices = cKDTree(tree).query(points)
    return np.asarray(distances, np.float64), np.asarray(indices, np.intp)
