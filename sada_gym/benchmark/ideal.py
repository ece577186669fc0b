"""`ideal`: the control that knows the answer, to read the adversaries' figures by."""

from __future__ import annotations

import numpy as np

from sada_gym.parameters import Mu


def draw_ideal(fooling_set: Mu, n: int, seed: int) -> Mu:
    """Draw n mu uniformly from a reference set's fooling set: what a perfect adversary would do.

    Without replacement, unless there are fewer points than that. At a point of the fooling set
    the agent is fooled on at least half of the seeds, not on all: the ideal AFR is below 1.

    Args:
        fooling_set: (m, d), m >= 1; not the points that coverage is measured by.
        n: How many.
        seed: Fixes the draw.
    """
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(fooling_set), n, replace=len(fooling_set) < n)
    drawn: Mu = fooling_set[rows]
    return drawn
