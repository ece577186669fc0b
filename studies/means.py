"""Means of few values, with their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t


def mean_text(values: Sequence[float], digits: int) -> str:
    """Write a mean with so many digits, and from two values on Student's 95 % interval."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return f"{mean:.{digits}f}"
    # as in a table of t: the published intervals were made with three decimals
    quantile = round(float(t.ppf(0.975, len(values) - 1)), 3)
    half = quantile * float(np.std(values, ddof=1)) / len(values) ** 0.5
    return f"{mean:.{digits}f} ± {half:.{digits}f}"
