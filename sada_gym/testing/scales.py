"""The same landscape on other scales of Q: the fooling set stays, the numbers change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

_SMALLEST = 1e-9


class Scale(NamedTuple):
    """A strictly increasing map of [0, 1] to itself, of scores and thresholds alike."""

    name: str
    map: Callable[[npt.ArrayLike], Any]


def scales(scores: npt.ArrayLike) -> tuple[Scale, ...]:
    """Return Q itself, Q^4, log Q and the rank of Q: the share of `scores`, (n,), below it."""
    known = np.unique(np.append([0.0, 1.0], scores))
    share = np.arange(len(known)) / (len(known) - 1)
    return (
        Scale("Q", np.asarray),
        Scale("Q^4", lambda q: np.asarray(q) ** 4),
        Scale("log Q", _log),
        Scale("rank Q", lambda q: np.interp(np.asarray(q), known, share)),
    )


def _log(q: npt.ArrayLike) -> Any:
    """Map 0 to 0 and 1 to 1 by log(Q + 1e-9), since log 0 is infinite."""
    low, high = np.log10(_SMALLEST), np.log10(1.0 + _SMALLEST)
    return (np.log10(np.add(q, _SMALLEST)) - low) / (high - low)
