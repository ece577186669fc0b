"""Chooses the samples that a video shows."""

from __future__ import annotations

import numpy as np

from sada_gym.errors import UserError, check_integer
from sada_gym.evaluations import Evaluations


def choose(samples: Evaluations, *, worst: int | None, sample: int | None) -> list[int]:
    """Return the rows of the `worst` samples, None for the very worst, or the one `sample`.

    Raises:
        UserError: If both are given, or there are not as many samples.
    """
    if worst is not None and sample is not None:
        raise UserError("Expected the number of worst samples or one sample, got both.")
    if sample is not None:
        check_integer("sample", sample, 0, len(samples) - 1)
        return [int(sample)]
    count = 1 if worst is None else worst
    check_integer("worst", count, 1, len(samples))
    rows: list[int] = np.argsort(samples.score, kind="stable")[:count].tolist()
    return rows
