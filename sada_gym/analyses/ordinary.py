"""Worlds as in ordinary use, beside those that an adversary chose: the benign arm of a test."""

from __future__ import annotations

import numpy as np

from sada_gym.adversaries.query_pool import draw_permitted, draw_uniform
from sada_gym.application import Application
from sada_gym.parameters import Mu

ORDINARY_WORLDS = 100
ORDINARY_SEEDS = 2**23
"""Where their seeds begin in the validation stream."""

_DRAWING_SEED = 67


def ordinary_worlds(application: Application, count: int, seed: int) -> Mu:
    """Draw worlds that can exist, by the density, or evenly where there is none, (count, d)."""
    density, rng = application.density, np.random.default_rng((seed, _DRAWING_SEED))

    def draw(n: int) -> Mu:
        if density is None:
            return draw_uniform(n, len(application.parameters), rng)
        return density.sample(n, rng)

    return draw_permitted(draw, count, application.permits) if count else draw(0)
