"""What the missing runs of a benchmark will cost, by what other runs took."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from sada_gym.board.benchmark.folder import RunTiming
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
    estimates = []
    for (table, track), chosen in sorted(by_place.items()):
        keys = [[like(run.key) for like in _LIKE] for run in chosen]
        known = [next((took[key] for key in likes if key in took), None) for likes in keys]
        seconds = [sum(times) / len(times) for times in known if times is not None]
        protocols = [run.experiment.protocol for run in chosen]
        evaluations = sum(protocol.budget + protocol.samples for protocol in protocols)
        estimate = CostEstimate(
            table=table,
            track=track,
            runs=len(chosen),
            evaluations=evaluations,
            core_hours=sum(seconds) / 3600,
            unknown=len(chosen) - len(seconds),
        )
        estimates.append(estimate)
    return estimates
