"""The invalid worlds of a run: how many there were, and an example."""

from __future__ import annotations

from collections.abc import Mapping

from sada_gym.application import INFEASIBLE, Application
from sada_gym.evaluation.evaluator import MANY, MOST_INVALID, too_many_invalid
from sada_gym.evaluation.oracle import Oracle
from sada_gym.foundations.files import Strict


class InvalidWorlds(Strict):
    """The worlds of a run that broke, which are no failures of the agent, and the first of them.

    Attributes:
        queries: The number of training queries with such a world.
        samples: The number of test samples with such a world.
        infeasible: The number of queries outside the region that `feasible=` allows; they cost a
            query, and are not among the others.
        parameters: Its physical values by name; None where no world broke, like the next two.
        seed: Its seed.
        reason: What it raised, or what was wrong with it.
    """

    queries: int
    samples: int
    infeasible: int = 0
    parameters: dict[str, float] | None = None
    seed: int | None = None
    reason: str | None = None


def invalid_worlds(application: Application, train: Oracle, test: Oracle) -> InvalidWorlds | None:
    """Sum up the invalid worlds of two oracles; None where there are none."""
    if not train.invalid and not test.invalid:
        return None
    queries, samples = _broken(train.invalid), _broken(test.invalid)
    summary = InvalidWorlds(
        queries=len(queries),
        samples=len(samples),
        infeasible=len(train.invalid) - len(queries),
    )
    for oracle, reasons in ((train, queries), (test, samples)):
        for row, reason in reasons.items():
            record = oracle.record
            example = {
                "parameters": application.parameters.describe(record.mu[row]),
                "seed": int(record.seed[row]),
                "reason": reason,
            }
            return summary.model_copy(update=example)
    return summary


def check_share(application: Application, oracle: Oracle) -> None:
    """Raise `UserError` if too large a share of an oracle's worlds is invalid, or all are."""
    reasons, record = oracle.invalid, oracle.record
    broken = _broken(reasons)
    judged = len(record) - (len(reasons) - len(broken))
    many = judged >= MANY and len(broken) > MOST_INVALID * judged
    if broken and (many or len(broken) == judged):
        row = next(iter(broken))
        raise too_many_invalid(len(broken), judged, application, record.mu[row], broken[row])


def _broken(reasons: Mapping[int, str]) -> dict[int, str]:
    return {row: reason for row, reason in reasons.items() if reason != INFEASIBLE}
