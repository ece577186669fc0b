"""Fresh samples: rows drawn until there are enough of them, all different and none known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import AdversaryError

_ROUNDS_BEFORE_STIRRING = 100
_STIR = 1e-4
_WINDOW = 20
_LEAST_NEW = 0.1
_MOST_STIR = 0.5


def row_keys(mu: npt.NDArray[np.float32]) -> set[bytes]:
    """Give what tells the rows of mu (n, d) apart."""
    # adding 0 turns -0 into 0: equal rows have equal bytes
    return {row.tobytes() for row in mu + np.float32(0.0)}


def fresh_rows(
    propose: Callable[[int, float], npt.NDArray[np.floating[Any]]],
    shape: tuple[int, int],
    known: set[bytes],
) -> npt.NDArray[np.float32]:
    """Collect rows, no two equal and none known: `shape`, (n, d), float32 in [-1, 1].

    After 100 rounds the proposals are stirred, by 1e-4. Whenever less than a tenth of what 20
    further rounds proposed was new, the stir grows tenfold, because few floats may be left around
    a single point. It gives up where even a stir as wide as the box brings little new.

    Args:
        propose: Called as propose(missing, stir), gives some rows. Its stir is 0 until few distinct
            ones seem to be left to draw, then a standard deviation to disturb them by.
        shape: n and d.
        known: The `row_keys` of what must not come again.

    Raises:
        AdversaryError: If a proposal is not finite, or so many different rows cannot be drawn.
    """
    chosen: dict[bytes, npt.NDArray[np.float32]] = {}
    rounds = proposed = found = 0
    stir = _STIR
    while len(chosen) < shape[0]:
        stirring = rounds > _ROUNDS_BEFORE_STIRRING
        before = len(chosen)
        drawn = propose(shape[0] - before, stir if stirring else 0.0)
        if not np.isfinite(drawn).all():
            raise AdversaryError(
                "Expected finite samples, but the adversary draws NaN or infinite ones: what it "
                "learnt is broken. Train it again, with options closer to the defaults."
            )
        clipped = np.clip(drawn, -1.0, 1.0).astype(np.float32)
        for row in clipped + np.float32(0.0):
            key = row.tobytes()
            if key not in known and len(chosen) < shape[0]:
                chosen.setdefault(key, row)
        rounds += 1
        if not stirring:
            continue
        proposed, found = proposed + len(drawn), found + len(chosen) - before
        if rounds % _WINDOW == 0:
            if found <= _LEAST_NEW * proposed:
                stir = _more(stir, len(chosen), shape[0])
            proposed = found = 0
    return np.array(list(chosen.values()), np.float32).reshape(shape)


def _more(stir: float, found: int, wanted: int) -> float:
    if stir > _MOST_STIR:
        raise AdversaryError(
            f"Expected {wanted:,} different samples, but after {found:,} the adversary draws "
            "hardly anything new. Ask for fewer, or train it again."
        )
    return 10.0 * stir
