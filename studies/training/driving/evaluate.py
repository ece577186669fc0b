"""Measure a driver: arrivals as trained for, and how often uniform mu fools it.

`python -m studies.training.driving.evaluate cil` measures a shipped driver anew; one
of your own is named by its safetensors file.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sada_gym.agents.wrappers import Predictor
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.camera.pinhole import Mount, camera
from sada_gym.envs.driving.episodes import DrivingEnd, DrivingEpisodes, DrivingStart
from sada_gym.envs.driving.world.route import LAYOUT, ROUTES
from sada_gym.envs.driving.world.weather import NAMES, TRAINING_WEATHERS
from studies.training.measuring import evaluate_uniform, parse_agent, rate


@dataclass(frozen=True)
class TaskFigures:
    """What was measured on one task.

    Attributes:
        runs: Drives at the default camera in the training weathers.
        arrived: How many of them arrived.
        unseen_runs: Drives in the two weathers that training never saw.
        unseen_arrived: How many of them arrived.
        samples: Uniform mu.
        fooled: How many of them fooled the driver.
        mean_score: Their mean Q.
    """

    runs: int
    arrived: int
    unseen_runs: int
    unseen_arrived: int
    samples: int
    fooled: int
    mean_score: float


def measure(
    driver: Predictor, *, seed: int, starts: int = 10, samples: int = 500
) -> dict[str, TaskFigures]:
    """Measure a driver on every task.

    Args:
        driver: The model.
        seed: Fixes starts, mu and rain.
        starts: How many starts each route has in each weather: the task's own, and others up to
            0.3 m and 3 degrees beside it.
        samples: Uniform mu.
    """
    figures = {}
    for task in ROUTES:
        application = DrivingApplication(task, agent=driver)
        rng = np.random.default_rng(seed)
        known = _arrivals(application, range(TRAINING_WEATHERS), starts, rng)
        unseen = _arrivals(application, range(TRAINING_WEATHERS, len(NAMES)), starts, rng)
        _, _, outcomes = evaluate_uniform(application, samples, rng)
        figures[task] = TaskFigures(
            runs=known.size,
            arrived=int(known.sum()),
            unseen_runs=unseen.size,
            unseen_arrived=int(unseen.sum()),
            samples=samples,
            fooled=int(outcomes.fooled.sum()),
            mean_score=float(outcomes.score.mean()),
        )
    return figures


def table(figures: dict[str, TaskFigures]) -> str:
    """Write the figures as a Markdown table."""
    lines = [
        "| task | arrived, training weathers | arrived, unseen weathers | mean Q, uniform mu "
        "| fooled by uniform mu (95 % interval) |",
        "| --- | --- | --- | --- | --- |",
    ]
    for task, f in figures.items():
        lines.append(
            f"| {task} | {f.arrived} of {f.runs} | {f.unseen_arrived} of {f.unseen_runs} "
            f"| {f.mean_score:.2f} | {rate(f.fooled, f.samples)} |"
        )
    return "\n".join(lines)


def _arrivals(
    application: DrivingApplication, weathers: range, starts: int, rng: np.random.Generator
) -> npt.NDArray[np.bool_]:
    drives = []
    for route in application.routes:
        for weather in weathers:
            for number in range(starts):
                beside = rng.uniform(-1, 1, 2) * (number > 0)
                drives.append(
                    DrivingStart(
                        route,
                        Mount(),
                        weather,
                        int(rng.integers(2**31)),
                        lateral_m=0.3 * float(beside[0]),
                        turned_rad=float(np.deg2rad(3 * beside[1])),
                    )
                )
    together = DrivingEpisodes(camera(LAYOUT), drives)
    application.play(together)
    arrived: npt.NDArray[np.bool_] = together.ending == DrivingEnd.ARRIVED
    return arrived


def main() -> None:
    """Print the table of a driver."""
    options, driver = parse_agent(argparse.ArgumentParser(description=__doc__), "SADA-Driving")
    print(table(measure(driver, seed=options.seed)))


if __name__ == "__main__":
    main()
