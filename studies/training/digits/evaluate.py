"""Measure a classifier: accuracy on the test images, and how often uniform mu fools it.

`python -m studies.training.digits.evaluate cnn` measures the shipped classifier anew, a path to
a file of weights any other.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sada_gym.envs.digits.agent.network import CLASSES, DigitNetwork
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.envs.digits.classifier import ClassifierAgent
from sada_gym.envs.digits.images import LabelledImages, test_images
from studies.training.measuring import evaluate_uniform, parse_agent, rate

SAMPLES = 10_000
"""Uniform mu for each fooling rate."""


@dataclass(frozen=True)
class Figures:
    """What was measured of one classifier.

    Attributes:
        test: Test images.
        right: How many of them it classifies correctly.
        samples: Uniform mu of `SADA-Digits-v0`, and of each digit's id.
        fooled: How many of them fooled it on `SADA-Digits-v0`.
        fooled_by_digit: How many of them fooled it on each digit's id.
    """

    test: int
    right: int
    samples: int
    fooled: int
    fooled_by_digit: tuple[int, ...]


def accuracy(network: DigitNetwork, data: LabelledImages) -> tuple[int, int]:
    """Count the images that a classifier gets right; give that count and how many there are."""
    answers = ClassifierAgent(network).act(data.images)
    return int((answers.argmax(axis=1) == data.labels).sum()), len(data)


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
        _, _, outcomes = evaluate_uniform(application, samples, rng)
        fooled.append(int(outcomes.fooled.sum()))
    return Figures(test, right, samples, fooled[0], tuple(fooled[1:]))


def table(figures: Mapping[str, Figures]) -> str:
    """Write the figures of some classifiers, by name, as Markdown; those by digit for the first."""
    lines = ["| classifier | test images right | fooled by uniform mu (95 % interval) |"]
    lines.append("| --- | --- | --- |")
    for name, f in figures.items():
        share = f"{100 * f.right / f.test:.1f} %: {f.right} of {f.test}"
        lines.append(f"| {name} | {share} | {rate(f.fooled, f.samples)} |")
    first = next(iter(figures.values()))
    lines += ["", "| digit | fooled by uniform mu (95 % interval) |", "| --- | --- |"]
    for digit, fooled in enumerate(first.fooled_by_digit):
        lines.append(f"| {digit} | {rate(fooled, first.samples)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables of a classifier."""
    options, network = parse_agent(argparse.ArgumentParser(description=__doc__), "SADA-Digits")
    print(table({options.agent: measure(network, seed=options.seed)}))


if __name__ == "__main__":
    main()
