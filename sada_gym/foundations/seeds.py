"""Evaluation seeds: Python ints in [0, 2**31), each of which fixes all randomness of a world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.errors import UserError, UserTypeError

SEED_BOUND = 2**31
"""Evaluation seeds are below it."""


def fold_seed(seed: int) -> int:
    """Return an evaluation seed for any int from 0 up.

    A seed below 2**31 stays as it is. A larger one becomes the upper 31 bits of the first word that
    NumPy's `SeedSequence` makes of it, so that s and 2**31 + s have nothing in common.
    """
    if seed < SEED_BOUND:
        return seed
    return int(np.random.SeedSequence(seed).generate_state(1, np.uint32)[0]) >> 1


def validate_seeds(seeds: Sequence[int], count: int, *, bounded: bool = True) -> list[int]:
    """Return `count` seeds, ints in [0, 2**31), as Python ints, else raise `ValueError`.

    Where they are not `bounded`, seeds may be any ints from 0 up, as Gymnasium's are.
    """
    if not isinstance(seeds, Sequence) and np.ndim(seeds) != 1:
        raise UserTypeError(f"Expected a list of seeds, one for each mu, got {seeds!r}.")
    if len(seeds) != count:
        raise UserError(f"Expected {count} seeds, one for each mu, got {len(seeds)}.")
    checked = []
    for seed in seeds:
        whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
        if not whole or seed < 0 or (bounded and seed >= SEED_BOUND):
            allowed = "in [0, 2**31)" if bounded else "from 0 up"
            raise UserError(
                f"Expected seeds to be ints {allowed}, got {seed!r}. "
                "Draw them with rng.integers(2**31)."
            )
        checked.append(int(seed))
    return checked
