"""Measure a pilot: gates passed on tracks as trained for, and how often uniform mu fools it.

`python -m studies.training.uav.evaluate waypoint-pid` measures a shipped pilot anew, a path to a
file of weights any other.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sada_gym.application import Outcomes
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.world.track import GATES, TEMPLATES
from sada_gym.evaluations import fools
from studies.training.measuring import evaluate_uniform, parse_agent, rate
from studies.training.uav.recipe import MILD

if TYPE_CHECKING:
    from sada_gym.envs.uav.agent.pilot import PilotLike

NEAR = 0.05
"""The standard deviation by which a mu that fooled is moved, to see whether it fools near by."""


@dataclass(frozen=True)
class TrackFigures:
    """What was measured on the tracks of one number of anchor points.

    Attributes:
        template_gates: Met on the undisturbed track.
        template_passed: How many of them were passed.
        mild_gates: Met on mild tracks that training never saw.
        mild_passed: How many of them were passed.
        samples: Uniform mu.
        fooled: How many of them fooled the pilot.
        mean_score: Their mean Q.
        again: How many of these fooled it again with another seed.
        near: How many did, moved by `NEAR`, with another seed.
        feasible: On how many of those tracks the privileged pilot is not fooled.
    """

    template_gates: int
    template_passed: int
    mild_gates: int
    mild_passed: int
    samples: int
    fooled: int
    mean_score: float
    again: int
    near: int
    feasible: int


def measure(
    pilot: PilotLike, *, seed: int, starts: int = 32, mild: int = 100, samples: int = 500
) -> dict[int, TrackFigures]:
    """Measure a pilot on the tracks of every number of anchor points.

    Args:
        pilot: A perception network, or an SB3 model.
        seed: Fixes mu, starts, light and background.
        starts: Seeds with which the undisturbed track is flown.
        mild: Mild tracks.
        samples: Uniform mu.
    """
    figures = {}
    for anchors in TEMPLATES:
        application = UAVApplication(anchors, agent=pilot)
        rng = np.random.default_rng(seed)

        _, _, template = evaluate_uniform(application, starts, rng, spread=0.0)
        _, _, on_mild = evaluate_uniform(application, mild, rng, spread=MILD.spread)
        mu, seeds, outcomes = evaluate_uniform(application, samples, rng)
        reference = application.privileged_score(mu, seeds)
        assert reference is not None
        fooling = mu[outcomes.fooled]
        moved = np.clip(fooling + rng.normal(0, NEAR, fooling.shape), -1, 1)
        again, near = (
            int(application.evaluate(at, rng.integers(2**31, size=len(at)).tolist()).fooled.sum())
            for at in (fooling, moved)
        )
        figures[anchors] = TrackFigures(
            template_gates=starts * GATES,
            template_passed=_passed(template),
            mild_gates=mild * GATES,
            mild_passed=_passed(on_mild),
            samples=samples,
            fooled=int(outcomes.fooled.sum()),
            mean_score=float(outcomes.score.mean()),
            again=again,
            near=near,
            feasible=int((~fools(reference, application.fooling_threshold)).sum()),
        )
    return figures


def table(figures: dict[int, TrackFigures]) -> str:
    """Write the figures as a Markdown table."""
    lines = [
        "| anchors | gates passed, undisturbed track | gates passed, mild tracks "
        "| mean Q, uniform mu | fooled by uniform mu (95 % interval) | of these again | near "
        "| privileged pilot: not fooled |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for anchors, f in figures.items():
        lines.append(
            f"| {anchors} | {_share(f.template_passed, f.template_gates)} "
            f"| {_share(f.mild_passed, f.mild_gates)} | {f.mean_score:.2f} "
            f"| {rate(f.fooled, f.samples)} "
            f"| {_share(f.again, f.fooled)} | {_share(f.near, f.fooled)} "
            f"| {100 * f.feasible / f.samples:.1f} % |"
        )
    return "\n".join(lines)


def _passed(outcomes: Outcomes) -> int:
    return round(float(outcomes.score.sum()) * GATES)


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} % of {whole:,}" if whole else "none"


def main() -> None:
    """Print the table of a pilot."""
    options, pilot = parse_agent(argparse.ArgumentParser(description=__doc__), "SADA-UAV")
    print(table(measure(pilot, seed=options.seed)))


if __name__ == "__main__":
    main()
