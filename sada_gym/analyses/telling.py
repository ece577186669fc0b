"""What the agent does in each weakness, and how sure the failures in it are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sada_gym.analyses.failures import PlayedAgain
from sada_gym.application import Application
from sada_gym.evaluations import Evaluations
from sada_gym.foundations.arrays import Bools
from sada_gym.foundations.behaviour import Behaviours
from sada_gym.measures.diagnosis.record import Diagnosis, Weakness
from sada_gym.measures.diagnosis.rules import holds
from sada_gym.measures.failures import Failure, Failures
from sada_gym.measures.rates import Rate
from sada_gym.parameters import Mu

_PLAYED, _FEWEST_PLAYED, _PLAYED_SHARE = 10, 3, 0.02
"""The failures of a weakness that are played again: at most so many, and this share of all known
worlds together."""


def tell(
    diagnosis: Diagnosis,
    application: Application,
    known: Evaluations,
    failures: Failures | None,
    again: PlayedAgain,
) -> Diagnosis:
    """Say of each weakness what the agent does in it, and how many failures in it are confirmed.

    Args:
        diagnosis: What is filled in.
        application: What the run attacked; some failures of each weakness are played again, unless
            that was done.
        known: The run's training queries and test samples.
        failures: Those among the samples, see `measures.failures`; None where there are none.
        again: Plays them, all together.
    """
    weaknesses = diagnosis.weaknesses
    each = min(
        _PLAYED, max(_FEWEST_PLAYED, int(_PLAYED_SHARE * len(known)) // max(1, len(weaknesses)))
    )
    failing = known[known.fooled(application.fooling_threshold)]
    listed = () if failures is None else failures.failures
    told = {
        (np.array(f.mu, np.float32).tobytes(), f.seed) for f in listed if f.behaviour is not None
    }
    untold = {
        place: _chosen(failing[_inside(weakness, application, failing.mu)], each, told)
        for place, weakness in enumerate(weaknesses)
        if weakness.behaviour is None and application.tells_behaviour
    }
    if untold:
        again.play(Evaluations.joined([*untold.values()]))
    tried = [failure for failure in listed if failure.valid_seeds]
    described = []
    for place, weakness in enumerate(weaknesses):
        changes: dict[str, object] = {}
        if place in untold:
            behaviours = Behaviours.of(again.play(untold[place]))
            changes["behaviour"] = None if behaviours is None else behaviours.sentence
        if tried:
            changes["confirmed"] = _confirmed(weakness, application, tried)
        described.append(weakness.model_copy(update=changes))
    return diagnosis.model_copy(update={"weaknesses": tuple(described)})


def _inside(weakness: Weakness, application: Application, mu: Mu) -> Bools:
    return holds(weakness.conditions, application.parameters, mu)


def _chosen(failing: Evaluations, count: int, told: set[tuple[bytes, int]]) -> Evaluations:
    """Choose so many failures: first those whose behaviour is listed, then evenly.

    So a later diagnosis chooses the same ones, and an attack plays none of them twice.
    """
    keys = [(mu.tobytes(), seed) for mu, seed in zip(failing.mu, failing.seed, strict=True)]
    known = np.array([key in told for key in keys], np.bool_)
    played, others = failing[known][:count], failing[~known]
    left = min(count - len(played), len(others))
    return played + others[np.linspace(0, len(others) - 1, left).astype(np.intp)]


def _confirmed(
    weakness: Weakness, application: Application, tried: Sequence[Failure]
) -> Rate | None:
    inside = _inside(weakness, application, np.array([failure.mu for failure in tried], np.float32))
    own = [tried[i] for i in np.flatnonzero(inside).tolist()]
    return Rate.of(sum(failure.fails_again for failure in own), len(own)) if own else None
