"""What the missing runs of a benchmark will cost, by what other runs took."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from sada_gym.benchmark.folder import RunTiming
from sada_gym.experiment.record import RunKey, RunSettings


@dataclass(frozen=True)
class CostEstimate:
    """What the missing runs of a table cost on one track.

    Attributes:
        evaluations: The most evaluations that they ask for, training queries and test samples. Runs
            of one track, agent and seed share some.
        core_hours: The hours of one core that those runs take whose like is known.
        unknown: The number of the other runs.
    """

    table: str
    track: str
    runs: int
    evaluations: int
    core_hours: float
    unknown: int


_LIKE: tuple[Callable[[RunKey], tuple[str, ...]], ...] = (
    lambda run: (run.label, run.table, run.track, run.agent),
    lambda run: (run.label, run.table, run.track),
    lambda run: (run.label, run.track),
)
"""Which runs take about as long as another one; the first that are known count."""


def estimate_costs(runs: Sequence[RunSettings], costs: Iterable[RunTiming]) -> list[CostEstimate]:
    """Estimate what runs cost, table by table and track by track, by what finished runs took."""
    took: dict[tuple[str, ...], list[float]] = {}
    for timing in costs:
        for like in _LIKE:
            took.setdefault(like(timing), []).append(timing.core_s or timing.wall_s)
    by_place: dict[tuple[str, str], list[RunSettings]] = {}
    for run in runs:
        by_place.setdefault((run.key.table, run.key.track), []).append(run)
    return [
        _of_place(table, track, chosen, took) for (table, track), chosen in sorted(by_place.items())
    ]


def _of_place(
    table: str, track: str, runs: Sequence[RunSettings], took: dict[tuple[str, ...], list[float]]
) -> CostEstimate:
    seconds = []
    for run in runs:
        known = next((took[like(run.key)] for like in _LIKE if like(run.key) in took), None)
        if known is not None:
            seconds.append(sum(known) / len(known))
    return CostEstimate(
        table=table,
        track=track,
        runs=len(runs),
        evaluations=sum(
            run.experiment.protocol.budget + run.experiment.protocol.samples for run in runs
        ),
        core_hours=sum(seconds) / 3600,
        unknown=len(runs) - len(seconds),
    )
