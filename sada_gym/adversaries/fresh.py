"""Fresh samples: rows drawn until there are enough of them, all different and none excluded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sada_gym.errors import AdversaryError
from sada_gym.foundations.arrays import AnyFloats
from sada_gym.parameters import Mu

_ROUNDS_WITHOUT_NOISE = 100
_FIRST_NOISE, _MAX_NOISE = 1e-4, 0.5
_WINDOW = 20
_MIN_NEW = 0.1


def row_keys(mu: Mu) -> set[bytes]:
    """Return a key of each row of mu (n, d); equal rows have equal keys."""
    # adding 0 turns -0 into 0: equal rows have equal bytes
    return {row.tobytes() for row in mu + np.float32(0.0)}


def fresh_rows(
    propose: Callable[[int, float], AnyFloats], shape: tuple[int, int], excluded: set[bytes]
) -> Mu:
    """Collect rows, no two equal and none excluded: `shape`, (n, d), float32 in [-1, 1].

    After 100 rounds the proposals get noise of 1e-4. Whenever less than a tenth of the proposals of
    20 further rounds was new, the noise grows tenfold, up to the width of the box.

    `propose(missing, noise)` gives some rows; the noise is the standard deviation of what to add.
    `excluded` are the `row_keys` of what must not come again.

    Raises:
        AdversaryError: If a proposal is not finite, or so many different rows cannot be drawn.
    """
    chosen: dict[bytes, Mu] = {}
    rounds = proposed = added = 0
    noise = _FIRST_NOISE
    while len(chosen) < shape[0]:
        noisy = rounds > _ROUNDS_WITHOUT_NOISE
        before = len(chosen)
        drawn = propose(shape[0] - before, noise if noisy else 0.0)
        if not np.isfinite(drawn).all():
            raise AdversaryError(
                "Expected finite samples, but the adversary draws NaN or infinite ones: what it "
                "learnt is broken. Train it again, with options closer to the defaults."
            )
        clipped = np.clip(drawn, -1.0, 1.0).astype(np.float32)
        for row in clipped + np.float32(0.0):
            key = row.tobytes()
            if key not in excluded and len(chosen) < shape[0]:
                chosen.setdefault(key, row)
        rounds += 1
        if not noisy:
            continue
        proposed, added = proposed + len(drawn), added + len(chosen) - before
        if rounds % _WINDOW == 0:
            if added <= _MIN_NEW * proposed:
                if noise > _MAX_NOISE:
                    raise AdversaryError(
                        f"Expected {shape[0]:,} different samples, but after {len(chosen):,} the "
                        "adversary draws hardly anything new. Ask for fewer, or train it again."
                    )
                noise *= 10.0
            proposed = added = 0
    return np.array(list(chosen.values()), np.float32).reshape(shape)
