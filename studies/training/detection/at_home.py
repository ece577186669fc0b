"""Measure any detector in our worlds: how well it knows the views that people photograph.

`python -m studies.training.detection.at_home coco-centernet --image-size 320` prints, for each
class: AP50 and the mean score Q on views of the photographer's prior, and how often uniform mu fool
the detector. `--shapes` takes another set of shapes, and `--classes` some of the classes. The
benchmark's shapes are the default. A class that the detector or the set does not have is left out.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch

from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.detector import DetectorAgent
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from sada_gym.errors import UserError
from studies.training.detection.data import LabelledFrames
from studies.training.detection.evaluate import average_precision
from studies.training.detection.prior import photograph
from studies.training.measuring import evaluate_uniform, parse_agent, rate

AT_ONCE = 32
"""Views that are drawn and shown in one call."""


def views(
    application: DetectionApplication, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, list[dict[str, np.ndarray]]]:
    """Show an application's detector views of the prior; those without the object are left out.

    Returns:
        Images (n, size, size, 3), true boxes (n, 4), and the detections of each.
    """
    images, boxes, found = [], [], []
    detector = DetectorAgent(application.agent, label=application.label)
    for start in range(0, count, AT_ONCE):
        shapes = rng.choice(len(application.shapes), min(AT_ONCE, count - start))
        scenes = [photograph(application.shapes[i], rng) for i in shapes]
        drawn = application.renderer.render_batch(scenes, application.image_size)
        seen = [rendering for rendering in drawn if rendering.box is not None]
        images += [rendering.image for rendering in seen]
        boxes += [rendering.box for rendering in seen]
        found += detector.act([rendering.image for rendering in seen])
    return np.array(images), np.array(boxes, np.float32), found


def measure(applications: list[DetectionApplication], options: argparse.Namespace) -> str:
    """Measure a detector on classes, and write a Markdown table with a row a class."""
    rng = np.random.default_rng(options.seed)
    shown = [views(application, options.frames, rng) for application in applications]
    numbers = np.repeat([application.label for application in applications],
                        [len(boxes) for _, boxes, _ in shown])  # fmt: skip
    frames = LabelledFrames(
        np.concatenate([images for images, _, _ in shown]),
        np.concatenate([boxes for _, boxes, _ in shown]),
        numbers,
    )
    found = [
        {key: torch.from_numpy(column.copy()) for key, column in answer.items()}
        for _, _, answers in shown
        for answer in answers
    ]
    lines = [
        "| class | AP50 on the prior | mean Q on the prior | fooled by uniform mu |",
        "| --- | --- | --- | --- |",
    ]
    for application, (_, _, answers) in zip(applications, shown, strict=True):
        label = application.label
        precision = average_precision(found, frames, label)
        best = [one["scores"][one["labels"] == label].max(initial=0.0) for one in answers]
        _, _, outcomes = evaluate_uniform(application, options.samples, rng)
        fooled = rate(int(outcomes.fooled.sum()), options.samples)
        lines.append(
            f"| {application.object_class} | {precision:.2f} | {np.mean(best):.2f} | {fooled} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure a detector and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image-size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=100, help="views of the prior a class")
    parser.add_argument("--samples", type=int, default=100, help="uniform mu a class")
    parser.add_argument("--shapes", default=None)
    parser.add_argument("--classes", nargs="+", default=CLASSES)
    options, detector = parse_agent(parser, "SADA-Detection")
    applications = []
    for name in options.classes:
        try:
            applications.append(
                DetectionApplication(
                    name, agent=detector, shapes=options.shapes, image_size=options.image_size
                )
            )
        except UserError as error:
            print(f"Without {name}: {error}")
    print(measure(applications, options))


if __name__ == "__main__":
    main()
