"""The pixel attack: our adversaries beside FGSM, PGD and Square, on the same images and radii.

    python -m studies.pixel_attack --seed 0

The images are the first test images of each digit that the classifier gets right, two of each by
default. FGSM and PGD know the classifier's gradient, Square and the adversaries its score alone;
Square proposes as many images as an adversary asks queries. All attacks are judged by
`SADA-Pixel-v0`: what they make is turned into mu and evaluated. What was done is kept in `--work`,
and a second call goes on where the first was stopped.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from art.attacks.evasion import FastGradientMethod, ProjectedGradientDescent, SquareAttack
from art.estimators.classification import PyTorchClassifier

from sada_gym import adversaries
from sada_gym.envs.digits import DigitsApplication
from sada_gym.envs.pixel import PixelApplication
from sada_gym.foundations.determinism import generators_kept
from sada_gym.foundations.files import write_file
from sada_gym.oracle import Oracle

BUDGET, SAMPLES, PGD_STEPS = 1_000, 100, 40
WHITE_BOX = ("fgsm", "pgd")
LIBRARY = (*WHITE_BOX, "square")
OURS = ("random", "gaussian", "gmm10", "smc", "cma-mae", "bbgan")


@dataclass(frozen=True)
class Result:
    """What one attack did to one image.

    Attributes:
        found: Whether it made or queried a noise that fools.
        afr: Share of an adversary's 100 samples that fool; None for an attack that makes one.
    """

    found: bool
    afr: float | None


def chosen_images(of_each_digit: int) -> list[int]:
    """The first test images of each digit that the classifier gets right."""
    images = [DigitsApplication(digit).indices[:of_each_digit] for digit in range(10)]
    return sorted(np.concatenate(images).tolist())


def with_library(name: str, application: PixelApplication, seed: int) -> Result:
    """Attack an image with an attack of adversarial-robustness-toolbox."""
    image = application.images.images[application.indices]
    label = int(application.images.labels[application.indices[0]])
    classifier = PyTorchClassifier(
        application.agent,
        loss=torch.nn.CrossEntropyLoss(),
        input_shape=(1, *image.shape[1:]),
        nb_classes=10,
        clip_values=(0.0, 1.0),
        device_type="cpu",
    )
    radius = application.radius
    make: dict[str, Callable[[], object]] = {
        "fgsm": lambda: FastGradientMethod(classifier, eps=radius),
        "pgd": lambda: ProjectedGradientDescent(
            classifier, eps=radius, eps_step=radius / 10, max_iter=PGD_STEPS, verbose=False
        ),
        "square": lambda: SquareAttack(classifier, eps=radius, max_iter=BUDGET, verbose=False),
    }
    with generators_kept():
        np.random.seed(seed)  # noqa: NPY002 - the library draws from the global generator
        made = make[name]().generate(image[:, None].copy(), y=np.array([label]))[:, 0]
    mu = as_mu(image.astype(np.float64), made.astype(np.float64), radius)
    return Result(bool(application.evaluate(mu, [0]).fooled[0]), None)


def as_mu(clean: np.ndarray, made: np.ndarray, radius: float) -> np.ndarray:
    """The mu whose noise turns a clean image into the one made, (1, d)."""
    change = made - clean
    assert np.abs(change).max() <= radius + 1e-6
    room = np.minimum(radius, np.where(change > 0, 1.0 - clean, clean))
    share = np.divide(change, room, out=np.zeros_like(change), where=room > 0)
    return np.clip(share, -1.0, 1.0).reshape(1, -1)


def with_adversary(name: str, application: PixelApplication, seed: int) -> Result:
    """Train one of our adversaries on an image, and judge its queries and samples."""
    fooled: list[bool] = []

    def score(mu: np.ndarray) -> np.ndarray:
        outcomes = application.evaluate(mu, [0] * len(mu))
        fooled.extend(outcomes.fooled.tolist())
        return outcomes.score

    dimension = len(application.parameters)
    adversary = adversaries.make(name, dimension, seed=seed)
    threshold = application.fooling_threshold
    with Oracle(score, dimension=dimension, threshold=threshold, budget=BUDGET) as oracle:
        adversary.train(oracle)
    samples = application.evaluate(adversary.sample(SAMPLES), [0] * SAMPLES).fooled
    return Result(any(fooled) or bool(samples.any()), float(samples.mean()))


def row(name: str, radius: float, results: list[Result]) -> str:
    successes = sum(result.found for result in results)
    rates = [result.afr for result in results if result.afr is not None]
    knows = "its gradient" if name in WHITE_BOX else f"Q, {BUDGET:,} queries"
    afr = f"{100 * np.mean(rates):.1f} %" if rates else "-"
    return f"| {radius:g} | `{name}` | {knows} | {successes} of {len(results)} | {afr} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--attacks", nargs="*", default=[*LIBRARY, *OURS])
    parser.add_argument("--radii", nargs="*", type=float, default=[0.15, 0.25])
    parser.add_argument("--of-each-digit", type=int, default=2)
    parser.add_argument("--images", type=int, help="only the first of these images")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=Path("runs/pixel-attack"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    rows = ["| radius | attack | knows | images fooled | AFR |", "| --- | --- | --- | --- | --- |"]
    for radius in arguments.radii:
        for name in arguments.attacks:
            results = []
            for image in chosen_images(arguments.of_each_digit)[: arguments.images]:
                file = arguments.work / f"{name}-{radius:g}-{image}-{arguments.seed}.json"
                if not file.exists():
                    application = PixelApplication(image, radius=radius)
                    attack = with_library if name in LIBRARY else with_adversary
                    result = attack(name, application, arguments.seed)
                    write_file(file, json.dumps(vars(result)).encode())
                results.append(Result(**json.loads(file.read_text())))
            rows.append(row(name, radius, results))
            print(rows[-1], flush=True)
    print("\n" + "\n".join(rows))


if __name__ == "__main__":
    main()
