"""The same landscape on other scales of Q: the fooling set stays, the numbers change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_LEAST = 1e-9


@dataclass(frozen=True)
class Scale:
    """A strictly increasing map of [0, 1] to itself.

    Attributes:
        name: What it makes of Q.
        map: Maps scores, and with them the threshold: (n,) to (n,).
    """

    name: str
    map: Callable[[npt.ArrayLike], Array]


def scales(scores: npt.ArrayLike) -> tuple[Scale, ...]:
    """Give Q itself, Q^4, log Q and the rank of Q.

    Args:
        scores: (n,) scores at uniform mu: a score's rank is the share of them that lie below it.
    """
    known = np.unique(np.concatenate([[0.0, 1.0], np.asarray(scores, dtype=np.float64)]))
    share = np.arange(len(known)) / (len(known) - 1)
    return (
        Scale("Q", lambda q: np.asarray(q, dtype=np.float64)),
        Scale("Q^4", lambda q: np.asarray(q, dtype=np.float64) ** 4),
        Scale("log Q", _log),
        Scale("rank Q", lambda q: np.interp(np.asarray(q, dtype=np.float64), known, share)),
    )


def _log(q: npt.ArrayLike) -> Array:
    # clipped, since 1 + _LEAST is a little more than 1
    exponent = np.log10(np.asarray(q, dtype=np.float64) + _LEAST)
    scaled: Array = np.clip(1.0 - exponent / np.log10(_LEAST), 0.0, 1.0)
    return scaled
