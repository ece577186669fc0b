"""Measure a pilot: gates passed on tracks as trained for, and how often uniform mu fools it.

`python -m studies.training.uav.evaluate waypoint-pid` measures a shipped pilot anew, a path to a
file of weights any other.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sada_gym import agents
from sada_gym.envs.uav.application import UAVApplication
from sada_gym.envs.uav.world.templates import TEMPLATES
from sada_gym.envs.uav.world.track import GATES
from sada_gym.measures.rates import wilson_interval
from studies.training.uav.recipe import MILD

if TYPE_CHECKING:
    from sada_gym.envs.uav.agent.pilot import PilotLike


@dataclass(frozen=True)
class TrackFigures:
    """What was measured on the tracks of one number of anchor points.

    Attributes:
        template_gates: Met on the undisturbed template.
        template_passed: How many of them were passed.
        mild_gates: Met on mild tracks that training never saw.
        mild_passed: How many of them were passed.
        samples: Uniform mu.
        fooled: How many of them fooled the pilot.
        mean_score: Their mean Q.
        reference_passed: Share of those tracks' gates that the privileged pilot passes.
        feasible: On how many of those tracks it is not fooled.
    """

    template_gates: int
    template_passed: int
    mild_gates: int
    mild_passed: int
    samples: int
    fooled: int
    mean_score: float
    reference_passed: float
    feasible: int


def measure(
    pilot: PilotLike, *, seed: int, starts: int = 32, mild: int = 100, samples: int = 400
) -> dict[int, TrackFigures]:
    """Measure a pilot on the tracks of every number of anchor points.

    Args:
        pilot: A perception network, or an SB3 model.
        seed: Fixes mu, starts, light and background.
        starts: Seeds with which the template is flown.
        mild: Mild tracks.
        samples: Uniform mu.
    """
    figures = {}
    for anchors in TEMPLATES:
        application = UAVApplication(anchors, agent=pilot)
        rng = np.random.default_rng(seed)

        def passed(width: float, count: int) -> tuple[int, int]:
            mu = rng.uniform(-width, width, (count, len(application.parameters)))  # noqa: B023
            seeds = rng.integers(2**31, size=count).tolist()  # noqa: B023
            score = application.evaluate(mu, seeds).score  # noqa: B023
            return count * GATES, round(float(score.sum()) * GATES)

        template, on_mild = passed(0.0, starts), passed(MILD.spread, mild)
        mu = rng.uniform(-1, 1, (samples, len(application.parameters)))
        worlds = rng.integers(2**31, size=samples).tolist()
        outcomes = application.evaluate(mu, worlds)
        reference = application.reference_score(mu, worlds)
        figures[anchors] = TrackFigures(
            *template,
            *on_mild,
            samples=samples,
            fooled=int(outcomes.fooled.sum()),
            mean_score=float(outcomes.score.mean()),
            reference_passed=float(reference.mean()),
            feasible=int((reference > application.fooling_threshold).sum()),
        )
    return figures


def table(figures: dict[int, TrackFigures]) -> str:
    """Write the figures as a Markdown table."""
    lines = [
        "| anchors | gates passed, template | gates passed, mild tracks | mean Q, uniform mu "
        "| fooled by uniform mu (95 % interval) | privileged pilot: gates passed | not fooled |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for anchors, f in figures.items():
        low, high = wilson_interval(f.fooled, f.samples)
        lines.append(
            f"| {anchors} | {_share(f.template_passed, f.template_gates)} "
            f"| {_share(f.mild_passed, f.mild_gates)} | {f.mean_score:.2f} "
            f"| {100 * f.fooled / f.samples:.1f} % ({100 * low:.1f} to {100 * high:.1f}) "
            f"| {100 * f.reference_passed:.1f} % | {100 * f.feasible / f.samples:.1f} % |"
        )
    return "\n".join(lines)


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} % of {whole:,}"


def main() -> None:
    """Print the table of a pilot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pilot", help="a shipped pilot's name, or a file of weights")
    parser.add_argument("--seed", type=int, default=1_000)
    arguments = parser.parse_args()
    named = arguments.pilot
    try:
        pilot = agents.load(Path(named) if named.endswith(".safetensors") else named, "SADA-UAV")
    except ValueError as error:
        parser.error(str(error))
    print(table(measure(pilot, seed=arguments.seed)))


if __name__ == "__main__":
    main()
