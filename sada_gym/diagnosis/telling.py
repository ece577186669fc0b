"""What the agent does in each weakness, and how sure the failures in it are."""

from __future__ import annotations

import numpy as np

from sada_gym.application import Application
from sada_gym.behaviour import Behaviours
from sada_gym.diagnosis.record import Diagnosis, Weakness
from sada_gym.diagnosis.rules import holds
from sada_gym.evaluations import Evaluations
from sada_gym.failures import Failures, play_again
from sada_gym.measures.rates import Rate

_PLAYED, _FEWEST_PLAYED, _PLAYED_SHARE = 10, 3, 0.02
"""The failures of a weakness that are played again: at most so many, and this share of all known
worlds together."""


def tell(
    diagnosis: Diagnosis, application: Application, known: Evaluations, failures: Failures | None
) -> Diagnosis:
    """Say of each weakness what the agent does in it, and how many failures in it are confirmed.

    Args:
        diagnosis: What is filled in.
        application: What the run attacked; some failures of each weakness are played again, unless
            that was done.
        known: The run's training queries and test samples.
        failures: Those among the samples, see `sada_gym.failures`; None where there are none.
    """
    count = len(diagnosis.weaknesses)
    each = min(_PLAYED, max(_FEWEST_PLAYED, int(_PLAYED_SHARE * len(known)) // max(count, 1)))
    told = (
        _told(weakness, application, known, failures, each) for weakness in diagnosis.weaknesses
    )
    return diagnosis.model_copy(update={"weaknesses": tuple(told)})


def _told(
    weakness: Weakness,
    application: Application,
    known: Evaluations,
    failures: Failures | None,
    count: int,
) -> Weakness:
    found: dict[str, object] = {}
    space = application.parameters
    if weakness.behaviour is None and application.tells_behaviour:
        failing = known[known.fooled(application.fooling_threshold)]
        inside = failing[holds(weakness.conditions, space, failing.mu)]
        rows = np.unique(np.linspace(0, len(inside) - 1, min(count, len(inside))).astype(np.intp))
        behaviours = Behaviours.of(play_again(application, inside[rows]))
        found["behaviour"] = None if behaviours is None else behaviours.sentence
    tried = [] if failures is None else [one for one in failures.failures if one.valid_seeds]
    if tried:
        mu = np.array([failure.mu for failure in tried], np.float32)
        own = [tried[i] for i in np.flatnonzero(holds(weakness.conditions, space, mu))]
        again = sum(failure.fails_again for failure in own)
        found["confirmed"] = Rate.of(again, len(own)) if own else None
    return weakness.model_copy(update=found)
