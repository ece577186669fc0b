"""The model card of a detector says how it was trained, what it scores and its file's SHA-256."""

from __future__ import annotations

from pathlib import Path

from sada_gym.envs.detection.agent.network import Detector
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from studies.training.common import ModelCard
from studies.training.detection.evaluate import Figures, table
from studies.training.detection.recipe import DetectorRecipe


def write_card(
    path: Path,
    *,
    name: str,
    recipe: DetectorRecipe,
    seed: int,
    minutes: float,
    weights: Path,
    figures: Figures,
) -> None:
    """Write a model card: how it was trained, what it scores, and its file's SHA-256."""
    parameters = sum(v.numel() for v in Detector(CLASSES).parameters())
    ModelCard(
        name=name,
        description=f"""A single-stage detector of 12 classes ({parameters:,}
parameters, `sada_gym/envs/detection/agent/network.py`), trained from our own renders of
procedural shapes that are not the benchmark's. It has never seen a photograph.""",
        command=f"python -m studies.training.detection.train {name} --seed {seed} --out DIR",
        training=f"{minutes:.0f} minutes in one thread, rendering included",
        recipe=recipe,
        measured=f"""Measured by
`python -m studies.training.detection.evaluate {name} --seed {seed + 1_000}`:
{figures.frames} views of the prior a class on shapes that training never saw;
{figures.samples:,} uniform mu a class on the benchmark's shapes, fooled where Q <= 0.3.
Expected calibration error on the prior: {figures.calibration_error:.3f}. No confidence was
rescaled, and no weights were chosen by a fooling rate.""",
        figures=table(figures),
    ).write(path, weights)
