"""Measure a driver: how often it arrives in nominal worlds, and how often uniform mu fools it.

`python -m studies.training.metadrive.evaluate metadrive-ppo` measures a shipped driver anew, a path
to a file of weights any other.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.envs.metadrive.application import MetaDriveApplication
from studies.training.measuring import evaluate_uniform, parse_agent, rate


@dataclass(frozen=True)
class Figures:
    """What was measured.

    Attributes:
        worlds: Worlds of each kind.
        arrived: In how many nominal worlds it arrived.
        fooled: How many uniform mu fooled it.
        mean_score: The mean Q of uniform mu.
    """

    worlds: int
    arrived: int
    fooled: int
    mean_score: float


def measure(driver: Any, *, seed: int, worlds: int = 100) -> Figures:
    """Measure a driver.

    Args:
        driver: An SB3 model.
        seed: Fixes mu and evaluation seeds.
        worlds: Worlds of each kind.
    """
    application = MetaDriveApplication(agent=driver)
    rng = np.random.default_rng(seed)
    nominal = application.evaluate(np.tile(application.nominal, (worlds, 1)), range(worlds))
    _, _, uniform = evaluate_uniform(application, worlds, rng)
    return Figures(
        worlds,
        int((~nominal.fooled).sum()),
        int(uniform.fooled.sum()),
        float(uniform.score.mean()),
    )


def table(figures: Figures) -> str:
    """Write the figures in Markdown."""
    return f"""| what | figure (95 % interval) |
| --- | --- |
| arrived, nominal | {rate(figures.arrived, figures.worlds)} |
| mean Q, uniform mu | {figures.mean_score:.2f} |
| fooled by uniform mu | {rate(figures.fooled, figures.worlds)} |"""


def main() -> None:
    """Print the table of a driver."""
    parser = argparse.ArgumentParser(description=__doc__)
    options, driver = parse_agent(parser, "SADA-DrivingMetaDrive")
    print(table(measure(driver, seed=options.seed)))


if __name__ == "__main__":
    main()
