"""Two runs beside each other: the worlds that both evaluated, and the settings that differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.analyses.report.views import RunView
from sada_gym.evaluations import Evaluations


@dataclass(frozen=True)
class Paired:
    """How two agents, or one agent twice, did in worlds that both runs evaluated.

    Attributes:
        p_value: McNemar's exact test of whether both fail equally often; None where no world tells
            them apart.
    """

    worlds: int
    both: int
    first_alone: int
    second_alone: int
    p_value: float | None


def pair(first: RunView, second: RunView) -> Paired | None:
    """Compare two runs in the worlds of the same mu and seed; None where there are none.

    Worlds of different parameters or ranges are different worlds.
    """
    if first.columns.parameters != second.columns.parameters:
        return None
    ours, theirs = (_verdicts(run) for run in (first, second))
    common = ours.keys() & theirs.keys()
    if not common:
        return None
    pairs = [(ours[key], theirs[key]) for key in common]
    alone = pairs.count((True, False)), pairs.count((False, True))
    return Paired(len(pairs), pairs.count((True, True)), *alone, _mcnemar(*alone))


def _mcnemar(first: int, second: int) -> float | None:
    from scipy.stats import binomtest

    return float(binomtest(first, first + second).pvalue) if first + second else None


def _verdicts(run: RunView) -> dict[tuple[bytes, int], bool]:
    worlds = Evaluations.joined([run.samples, run.queries]).valid
    fooled = worlds.fooled(run.target.fooling_threshold).tolist()
    mu = np.ascontiguousarray(worlds.mu + np.float32(0.0))  # -0 is 0
    keys = zip((row.tobytes() for row in mu), worlds.seed.tolist(), strict=True)
    return dict(zip(keys, fooled, strict=True))


def different_settings(first: RunView, second: RunView) -> list[tuple[str, str, str]]:
    """List the settings in which two runs differ, with both values."""
    ours, theirs = (_flat(run.settings.model_dump(mode="json")) for run in (first, second))
    return [
        (name, ours.get(name, "-"), theirs.get(name, "-"))
        for name in dict.fromkeys([*ours, *theirs])
        if ours.get(name) != theirs.get(name)
    ]


def _flat(record: Mapping[str, Any], start: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for name, value in record.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{start}{name}.")
        else:
            flat[f"{start}{name}"] = str(value)
    return flat
