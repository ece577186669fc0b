"""Says whether samples collapsed: the adversary knows one fooling world and repeats it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError
from sada_gym.foundations.arrays import as_array

MIN_SAMPLES = 10
"""The least number of samples whose spread means something."""

MIN_SHARE = 0.05
"""Samples collapsed where the spread is below this share of uniform's in every dimension."""

_UNIFORM_STD = 1.0 / math.sqrt(3.0)


def collapse_flag(mu: npt.ArrayLike) -> str | None:
    """Return a sentence if the samples crowd around one point, else None.

    They do where in *every* dimension their standard deviation is below a twentieth of a uniform
    sample's, 1 / sqrt(3). An attack fooling rate of 100 % then shows one world, not the ways in
    which the agent fails. Every dimension has to be narrow: a fooling set may be narrow where the
    agent is sensitive, but it is wide along what does not matter to the agent. The twentieth lies
    below all that a search for the lowest score leaves (`bayesian` in the published results: 0.12
    and more), and above what a GAN that collapsed draws (0.0002 to 0.05). A sample of a few
    separate points is not called collapsed; `coverage` shows that.

    Raises:
        ValueError: If mu is no array of shape (n, d) of finite numbers.
    """
    samples = as_array(mu, "mu").astype(np.float64)
    if samples.ndim != 2 or not samples.shape[1] or not np.isfinite(samples).all():
        raise UserError(f"Expected finite mu of shape (n, d), d >= 1, got {samples.shape}.")
    if len(samples) < MIN_SAMPLES:
        return None
    widest = float(samples.std(axis=0).max()) / _UNIFORM_STD
    if widest >= MIN_SHARE:
        return None
    return (
        "the samples collapsed to nearly one point: in no dimension is their spread above "
        f"{MIN_SHARE:.0%} of a uniform sample's, so the fooling rate tells of one world only"
    ).replace("%", " %")
