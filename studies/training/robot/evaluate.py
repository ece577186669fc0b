"""Measure a robot: goals reached in nominal and mild worlds, and how often uniform mu fools it.

`python -m studies.training.robot.evaluate ppo` measures a shipped robot anew, a path to a file of
weights any other.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.application import Outcomes
from sada_gym.envs.robot.application import PLANS, RobotApplication
from sada_gym.envs.robot.world.floor_plan import TRIPS
from sada_gym.evaluations import fools
from studies.training.measuring import evaluate_uniform, parse_agent, rate

MILD = 0.25
_GOALS = PLANS * TRIPS


@dataclass(frozen=True)
class Figures:
    """What was measured.

    Attributes:
        worlds: Worlds of each kind.
        nominal: Goals reached in nominal worlds.
        mild: Goals reached in mild worlds.
        mean_score: The mean Q of uniform mu.
        fooled: How many of them fooled the robot.
        again: How many of those that fooled did so again on another seed.
        reference: Goals that the privileged driver reaches on uniform mu.
        feasible: On how many uniform mu it is not fooled.
        referenced: The number of uniform mu on which it drove.
    """

    worlds: int
    nominal: int
    mild: int
    mean_score: float
    fooled: int
    again: int
    reference: int
    feasible: int
    referenced: int


def measure(robot: Any, *, seed: int, worlds: int = 500, referenced: int = 100) -> Figures:
    """Measure a robot.

    Args:
        robot: An SB3 model.
        seed: Fixes mu and evaluation seeds.
        worlds: Worlds of each kind.
        referenced: Uniform mu on which the privileged driver drives too.
    """
    application = RobotApplication(agent=robot)
    rng = np.random.default_rng(seed)
    _, _, nominal = evaluate_uniform(application, worlds, rng, spread=0.0)
    _, _, mild = evaluate_uniform(application, worlds, rng, spread=MILD)
    mu, seeds, uniform = evaluate_uniform(application, worlds, rng)
    fooled = mu[uniform.fooled]
    again = application.evaluate(fooled, rng.integers(2**31, size=len(fooled)).tolist())
    reference = application.privileged_score(mu[:referenced], seeds[:referenced])
    assert reference is not None
    return Figures(
        worlds=worlds,
        nominal=_goals(nominal),
        mild=_goals(mild),
        mean_score=float(uniform.score.mean()),
        fooled=len(fooled),
        again=int(again.fooled.sum()),
        reference=round(float(reference.sum()) * _GOALS),
        feasible=int((~fools(reference, application.fooling_threshold)).sum()),
        referenced=referenced,
    )


def table(f: Figures) -> str:
    """Write the figures as a Markdown table."""
    goals = f.worlds * _GOALS
    return "\n".join(
        [
            "| what | figure (95 % interval) |",
            "| --- | --- |",
            f"| goals reached, nominal | {rate(f.nominal, goals)} |",
            f"| goals reached, mild | {rate(f.mild, goals)} |",
            f"| mean Q, uniform mu | {f.mean_score:.2f} |",
            f"| fooled by uniform mu | {rate(f.fooled, f.worlds)} |",
            f"| fooled again on another seed | {rate(f.again, f.fooled)} |",
            f"| privileged driver: goals reached | {rate(f.reference, f.referenced * _GOALS)} |",
            f"| privileged driver: not fooled | {rate(f.feasible, f.referenced)} |",
        ]
    )


def _goals(outcomes: Outcomes) -> int:
    return round(float(outcomes.score.sum()) * _GOALS)


def main() -> None:
    """Print the table of a robot."""
    options, robot = parse_agent(argparse.ArgumentParser(description=__doc__), "SADA-Robot")
    print(table(measure(robot, seed=options.seed)))


if __name__ == "__main__":
    main()
