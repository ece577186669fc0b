"""Made-up experiments, for tests of what is made of results."""

from __future__ import annotations

from sada_gym.evaluation.key import ApplicationKey
from sada_gym.experiment.adversary import AdversarySpec
from sada_gym.experiment.record import Experiment, Protocol
from sada_gym.experiment.target import ReferenceSummary, Target


def made_target(
    track: str,
    agent: str = "",
    *,
    application: str = "Made",
    fingerprint: str = "f",
    reference: ReferenceSummary | None = None,
) -> Target:
    key = ApplicationKey(name=application, version=0, settings={}, fingerprint=fingerprint)
    return Target(
        track=track, agent=agent, application=key, fooling_threshold=0.3, reference=reference
    )


def made_experiment(
    target: Target, adversary: str, *, rule: str, budget: int, samples: int, seed: int | None = None
) -> Experiment:
    return Experiment(
        target=target,
        adversary=AdversarySpec(name=adversary, resolved={}),
        protocol=Protocol(rule=rule, budget=budget, samples=samples),
        seed=seed,
    )
