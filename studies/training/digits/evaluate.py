"""Measure a classifier: accuracy on the test images, and how often uniform mu fools it.

`python -m studies.training.digits.evaluate cnn` measures the shipped classifier anew, a path to
a file of weights any other.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sada_gym import agents
from sada_gym.envs.digits.agent.network import CLASSES, DigitNetwork
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.envs.digits.classifier import Classifier
from sada_gym.envs.digits.images import LabelledImages, test_images
from sada_gym.measures.rates import wilson_interval

SAMPLES = 10_000
"""Uniform mu for each fooling rate."""


@dataclass(frozen=True)
class Figures:
    """What was measured of one classifier.

    Attributes:
        test: Test images.
        right: How many of them it classifies rightly.
        samples: Uniform mu of `SADA-Digits-v0`, and of each digit's id.
        fooled: How many of them fooled it on `SADA-Digits-v0`.
        fooled_by_digit: And on each digit's id.
    """

    test: int
    right: int
    samples: int
    fooled: int
    fooled_by_digit: tuple[int, ...]


def accuracy(network: DigitNetwork, data: LabelledImages) -> tuple[int, int]:
    """How many images a classifier gets right, and of how many."""
    found = Classifier(network).probabilities(data.images)
    return int((found.argmax(axis=1) == data.labels).sum()), len(data)


def measure(network: DigitNetwork, *, seed: int, samples: int = SAMPLES) -> Figures:
    """Measure a classifier on the test images.

    Args:
        network: The classifier.
        seed: Fixes mu and which images they change.
        samples: Uniform mu for each fooling rate.
    """
    right, test = accuracy(network, test_images())
    fooled = []
    for digit in (None, *range(CLASSES)):
        application = DigitsApplication(digit, agent=network)
        rng = np.random.default_rng([seed, CLASSES if digit is None else digit])
        mu = rng.uniform(-1, 1, (samples, len(application.parameters)))
        outcomes = application.evaluate(mu, rng.integers(2**31, size=samples).tolist())
        fooled.append(int(outcomes.fooled.sum()))
    return Figures(test, right, samples, fooled[0], tuple(fooled[1:]))


def table(figures: Mapping[str, Figures]) -> str:
    """The figures of some classifiers, by name, as Markdown tables; by digit for the first."""
    lines = ["| classifier | test images right | fooled by uniform mu (95 % interval) |"]
    lines.append("| --- | --- | --- |")
    for name, f in figures.items():
        share = f"{100 * f.right / f.test:.1f} %: {f.right} of {f.test}"
        lines.append(f"| {name} | {share} | {_rate(f.fooled, f.samples)} |")
    first = next(iter(figures.values()))
    lines += ["", "| digit | fooled by uniform mu (95 % interval) |", "| --- | --- |"]
    for digit, fooled in enumerate(first.fooled_by_digit):
        lines.append(f"| {digit} | {_rate(fooled, first.samples)} |")
    return "\n".join(lines)


def _rate(fooled: int, samples: int) -> str:
    low, high = wilson_interval(fooled, samples)
    return f"{100 * fooled / samples:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def main() -> None:
    """Print the tables of a classifier."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("classifier", help="a shipped classifier's name, or a file of weights")
    parser.add_argument("--seed", type=int, default=1_000)
    arguments = parser.parse_args()
    named = arguments.classifier
    try:
        network = agents.load(
            Path(named) if named.endswith(".safetensors") else named, "SADA-Digits"
        )
    except ValueError as error:
        parser.error(str(error))
    print(table({named: measure(network, seed=arguments.seed)}))


if __name__ == "__main__":
    main()
