"""Measure a detector: AP50 and calibration on the prior, fooling rate over uniform mu.

`python -m studies.training.detection.evaluate photographer` measures a shipped detector anew.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from sada_gym.envs.detection.agent.network import Detector, iou
from sada_gym.envs.detection.application import DetectionApplication
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from studies.training.detection.data import LabelledFrames, validation_frames
from studies.training.detection.prior import photograph
from studies.training.measuring import evaluate_uniform, parse_agent

BINS = 10


@dataclass(frozen=True)
class Figures:
    """What was measured, per class in the order of `CLASSES`.

    Attributes:
        frames: Validation frames of each class, views of the prior, shapes never seen.
        ap50: Average precision at IoU 0.5.
        confidence: Mean score Q on those frames: the highest confidence in the true class.
        calibration_error: Expected calibration error of all detections on those frames, ten bins.
        samples: Uniform mu of each class, on the benchmark's shapes.
        fooling_rate: Share of them that fool the detector.
    """

    frames: int
    ap50: tuple[float, ...]
    confidence: tuple[float, ...]
    calibration_error: float
    samples: int
    fooling_rate: tuple[float, ...]


Detections = list[dict[str, torch.Tensor]]


def measure(
    model: Detector, *, seed: int, frames: int = 240, samples: int = 1_000, image_size: int = 128
) -> Figures:
    """Measure a detector with `frames` views of the prior and `samples` uniform mu a class."""
    known = validation_frames(frames, photograph, image_size=image_size, seed=seed)
    detections = detect(model, known.images)
    return Figures(
        frames=frames,
        ap50=tuple(average_precision(detections, known, k + 1) for k in range(len(CLASSES))),
        confidence=_confidence(detections, known),
        calibration_error=calibration_error(detections, known),
        samples=samples,
        fooling_rate=tuple(_fooling_rate(model, name, samples, seed) for name in CLASSES),
    )


def detect(model: Detector, images: npt.NDArray[np.uint8], tile: int = 16) -> Detections:
    """Run a detector over frames (n, size, size, 3)."""
    detections: Detections = []
    for start in range(0, len(images), tile):
        batch = torch.from_numpy(images[start : start + tile]).permute(0, 3, 1, 2).float() / 255
        with torch.inference_mode():
            detections += model(list(batch))
    return detections


def average_precision(detections: Detections, frames: LabelledFrames, label: int) -> float:
    """Return one class's AP at IoU 0.5, the area under the interpolated precision-recall curve."""
    scores, hits = _matches(detections, frames, label)
    order = np.argsort(-scores, kind="stable")
    hit_counts = np.cumsum(hits[order])
    recall = hit_counts / max(1, int((frames.labels == label).sum()))
    precision = hit_counts / np.arange(1, len(order) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(recall, prepend=0.0) * envelope).sum())


def calibration_error(detections: Detections, frames: LabelledFrames) -> float:
    """Return expected calibration error: the mean gap of confidence and share of hits by bin."""
    matches = [_matches(detections, frames, k + 1) for k in range(len(CLASSES))]
    scores = np.concatenate([s for s, _ in matches])
    hits = np.concatenate([h for _, h in matches])
    bins = np.minimum((scores * BINS).astype(int), BINS - 1)
    gaps = [
        abs(scores[bins == b].mean() - hits[bins == b].mean()) * (bins == b).mean()
        for b in np.unique(bins)
    ]
    return float(sum(gaps))


def _matches(
    detections: Detections, frames: LabelledFrames, label: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Return the scores of a class's detections, and which are the first to hit the true box."""
    scores: list[float] = []
    hits: list[bool] = []
    for i, detection in enumerate(detections):
        taken = frames.labels[i] != label
        truth = torch.from_numpy(frames.boxes[i])
        of_class = detection["labels"] == label
        for box, score in zip(
            detection["boxes"][of_class], detection["scores"][of_class], strict=True
        ):
            hit = not taken and float(iou(box, truth)) >= 0.5
            taken = taken or hit
            scores.append(float(score))
            hits.append(hit)
    return np.array(scores), np.array(hits, dtype=np.bool_)


def _confidence(detections: Detections, frames: LabelledFrames) -> tuple[float, ...]:
    best = np.zeros(len(detections))
    for i, detection in enumerate(detections):
        scores = detection["scores"][detection["labels"] == int(frames.labels[i])]
        best[i] = float(scores.max()) if len(scores) else 0.0
    return tuple(float(best[frames.labels == k + 1].mean()) for k in range(len(CLASSES)))


def _fooling_rate(model: Detector, name: str, samples: int, seed: int) -> float:
    application = DetectionApplication(name, agent=model)
    rng = np.random.default_rng([seed, CLASSES.index(name)])
    _, _, outcomes = evaluate_uniform(application, samples, rng)
    return float(outcomes.fooled.mean())


def table(figures: Figures) -> str:
    """Write the figures as a Markdown table."""
    lines = [
        "| class | AP50 on the prior | mean Q on the prior | fooled by uniform mu |",
        "| --- | --- | --- | --- |",
    ]
    columns = (figures.ap50, figures.confidence, figures.fooling_rate)
    means = [float(np.mean(column)) for column in columns]
    rows = [*zip(CLASSES, *columns, strict=True), ("**mean**", means[0], means[1], means[2])]
    for name, ap, q, afr in rows:
        lines.append(f"| {name} | {ap:.3f} | {q:.2f} | {100 * afr:.1f} % |")
    return "\n".join(lines)


def main() -> None:
    """Measure a detector and print its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--samples", type=int, default=1_000)
    options, detector = parse_agent(parser, "SADA-Detection")
    figures = measure(detector, seed=options.seed, frames=options.frames, samples=options.samples)
    print(table(figures))
    print(f"calibration error on the prior: {figures.calibration_error:.3f}")


if __name__ == "__main__":
    main()
