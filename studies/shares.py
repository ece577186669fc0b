"""Shares as studies print them."""

from __future__ import annotations

import numpy as np

from sada_gym.measures.rates import wilson_interval


def share(fooled: np.ndarray) -> str:
    """Write how many of some worlds fool, (n,) bool, as a share with its 95 % interval."""
    low, high = wilson_interval(int(fooled.sum()), len(fooled))
    return f"{100 * fooled.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"
