"""Intervals of counts of failures, weighted or not."""

from __future__ import annotations

from scipy.special import betaincinv, gammaincinv

_TAIL = 0.025


def gamma_interval(rate: float, variance: float, heaviest: float) -> tuple[float, float]:
    """Return the 95 % interval of a weighted sum of rare counts (Fay and Feuer 1997).

    Args:
        rate: The sum.
        variance: That of the sum.
        heaviest: The weight that one failure more would have. With nothing counted the upper end is
            3.7 times as much: the rule of three, two-sided.
    """
    low = 0.0
    if rate > 0.0 and variance > 0.0:
        low = variance / rate * float(gammaincinv(rate**2 / variance, _TAIL))
    mean, spread = rate + heaviest, variance + heaviest**2
    high = spread / mean * float(gammaincinv(mean**2 / spread, 1.0 - _TAIL))
    return min(low, 1.0), min(high, 1.0)


def exact_interval(failures: int, draws: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate of plain draws (Clopper and Pearson 1934)."""
    others = draws - failures
    low = float(betaincinv(failures, others + 1, _TAIL)) if failures else 0.0
    high = float(betaincinv(failures + 1, others, 1.0 - _TAIL)) if others else 1.0
    return low, high
